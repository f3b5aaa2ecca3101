"""One frame as a file: an uncompressed TIFF that is memory-mapped, with a checksum of its pixels."""

import hashlib
import io
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from fpplab.core.conventions import Image, raw_dtype
from fpplab.core.errors import DataError
from fpplab.core.files import open_regular, write_parts
from fpplab.sessions.journal import FrameRecord


@cache
def tiff_head(shape: tuple[int, ...], dtype: np.dtype[Any]) -> bytes:
    # shape (height, width)
    image, file = np.zeros(shape, dtype), io.BytesIO()
    tifffile.imwrite(file, image, photometric="minisblack", metadata=None)
    return file.getvalue()[: -image.nbytes]


def write_frame(path: Path, image: NDArray[Any]) -> str:
    # image (height, width)
    with ThreadPoolExecutor(max_workers=1) as worker:  # neither holds Python's lock
        checksum = worker.submit(_checksum, image)
        write_parts(path, tiff_head(image.shape, image.dtype), image.data)
    return checksum.result()


def read_frame(path: Path, record: FrameRecord, verify: bool) -> Image:
    # returns (height, width)
    index = record.index
    try:
        open_regular(path).close()
        image: Image = np.asarray(tifffile.memmap(path, mode="r"))
    except FileNotFoundError:
        raise DataError(f"{path}: frame {index} is missing") from None
    except Exception as error:
        raise DataError(f"{path}: frame {index} is truncated or damaged ({error})") from error
    expected = raw_dtype(record.bits)
    if image.dtype != expected or image.shape != (record.height, record.width):
        raise DataError(
            f"{path}: frame {index} is {image.dtype} {image.shape[::-1]} but the journal says "
            f"{expected} {(record.width, record.height)}"
        )
    if verify and _checksum(image) != record.sha256:
        raise DataError(f"{path}: frame {index} is corrupt: its checksum is not the journal's")
    return image


def _checksum(image: NDArray[Any]) -> str:
    return hashlib.sha256(np.ascontiguousarray(image).data).hexdigest()
