"""Files that hold grey images: pictures, TIFF files of several pages, NumPy arrays."""

import math
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import IO, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fpplab.core.archives import array_head, check_archive
from fpplab.core.conventions import Image, full_scale
from fpplab.core.errors import DataError, FppError
from fpplab.core.file_kinds import describe_file
from fpplab.core.files import open_regular
from fpplab.core.signatures import HEAD_BYTES, kind_of
from fpplab.sessions.channels import WAY_OUT, NotGreyError, grey_from_channels
from fpplab.sessions.grey_depth import BIT_DEPTHS
from fpplab.sessions.limits import SESSION_LIMITS as LIMITS
from fpplab.sessions.pictures import SIGNATURES, TIFF_SIGNATURES, PictureFile

_SPACE = rb"(?:\s|#[^\r\n]*[\r\n])+"
_HEAD = re.compile(rb"P([2356])%b(\d{1,7})%b(\d{1,7})%b(\d{1,5})(?:#[^\r\n]*[\r\n])*\s" % ((_SPACE,) * 3))
_OTHERS = {
    b"P1": "1-bit pixels (PBM)",
    b"P4": "1-bit pixels (PBM)",
    b"P7": "a PAM picture",
    b"Pf": "floating-point numbers (PFM)",
    b"PF": "floating-point numbers (PFM)",
}


def is_netpbm(head: bytes) -> bool:
    return re.match(rb"P[1-7fF]\s", head) is not None


class NetpbmFile:
    """One image in a PGM or PPM file."""

    pages, is_lossy = 1, False

    def __init__(self, stream: IO[bytes]) -> None:
        self._content = stream.read()
        if (other := _OTHERS.get(self._content[:2])) is not None:
            raise NotGreyError(f"holds {other}; {WAY_OUT}")
        head = _HEAD.match(self._content)
        if head is None:
            raise ValueError("its head lacks the width, the height or the greatest level")
        self._kind, width, height, self._max_level = map(int, head.groups())
        self._size, self._start = (width, height), head.end()
        if not (width and height and 0 < self._max_level < 1 << 16):
            raise ValueError(f"its head says {width} x {height} pixels of levels up to {self._max_level}")

    def size(self, page: int) -> tuple[int, int]:
        return self._size

    def stated_bits(self, page: int) -> int | None:
        """Depth by the greatest level that the head allows; one of 16 bits does not tell the camera's."""
        return {full_scale(bits): bits for bits in BIT_DEPTHS[1:-1]}.get(self._max_level)

    def read(self, page: int) -> Image:
        channels = 3 if self._kind in (3, 6) else 1
        count = self._size[0] * self._size[1] * channels
        levels = self._text_levels() if self._kind < 4 else self._binary_levels(count)
        if len(levels) != count:
            raise ValueError(f"{count} levels are expected and {len(levels)} are there")
        if (greatest := int(levels.max())) > self._max_level:
            raise ValueError(f"it has a level of {greatest}, and its head says {self._max_level} at most")
        stored = levels.astype(np.uint8 if self._max_level < 256 else np.uint16)
        return grey_from_channels(stored.reshape(self._size[1], self._size[0], channels))

    def _text_levels(self) -> NDArray[Any]:
        text = re.sub(rb"#[^\r\n]*", b"", self._content[self._start :])
        if re.search(rb"[^\d\s]", text):
            raise ValueError("its levels are not whole numbers")
        return np.array(text.split()).astype(np.int64)

    def _binary_levels(self, count: int) -> NDArray[Any]:
        dtype = np.dtype("u1" if self._max_level < 256 else ">u2")
        remaining = len(self._content) - self._start - count * dtype.itemsize
        if remaining < 0 or self._content[len(self._content) - remaining :].strip():
            more_or_fewer = "fewer" if remaining < 0 else "more"
            raise ValueError(f"bytes {more_or_fewer} than its head says: {abs(remaining)}")
        return np.frombuffer(self._content, dtype, count, self._start)


NPY, ZIP = b"\x93NUMPY", b"PK"
READ_FORMATS = "PNG, TIFF, JPEG, BMP, PGM, PPM, NPY and NPZ"


class ImagePlace(NamedTuple):
    """One image: a file, and which of those in it."""

    path: Path  # the file
    page: int  # of the image, from 0
    pages: int  # how many images the file holds

    def __str__(self) -> str:
        return f"{self.path}" if self.pages == 1 else f"{self.path} image {self.page}"

    @property
    def name(self) -> str:
        return str(self._replace(path=Path(self.path.name)))


class ImageFile(Protocol):
    """An open file with grey images in it."""

    @property
    def pages(self) -> int:
        """How many images the file holds."""

    @property
    def is_lossy(self) -> bool:
        """Whether its compression has changed grey levels."""

    def size(self, page: int) -> tuple[int, int]:
        """Return (width, height) in px of the image of that number, from 0, before it is read."""

    def read(self, page: int) -> Image:
        """Read an image (height, width) as stored, uint8 or uint16; raises `NotGreyError`."""

    def stated_bits(self, page: int) -> int | None:
        """Say how many bits a level has, 10 to 14; None where levels take whole bytes."""


class ReadImage(NamedTuple):
    """One image and what its file says of it."""

    place: ImagePlace  # where it is
    levels: Image  # its grey levels as stored, (height, width)
    is_lossy: bool  # whether compression has changed them
    stated_bits: int | None
    """Bits of a level by the file's head, where it says more than that they take 8 or 16."""


@contextmanager
def open_image_file(path: Path) -> Iterator[ImageFile]:
    """Open a file of grey images; a TIFF, NPY or NPZ file holds any number."""
    # The first bytes decide what the file is, not its name.
    try:
        with open_regular(path) as stream:
            head = stream.read(HEAD_BYTES)
            stream.seek(0)
            if head.startswith(NPY):
                yield _Array(path, stream, path.stat().st_size)
            elif head.startswith(ZIP):
                with zipfile.ZipFile(stream) as archive:
                    check_archive(archive, path.stat().st_size)
                    member = _only_member(path, archive)
                    with archive.open(member) as inside:
                        yield _Array(path, inside, member.file_size)
            elif is_netpbm(head):
                yield NetpbmFile(stream)
            else:
                _refuse_other_files(path, head)
                yield PictureFile(path, stream)
    except FppError:
        raise
    except NotGreyError as error:
        raise DataError(f"{path}: {error}") from error
    except Exception as error:
        raise DataError(f"{path}: is truncated or damaged ({error})") from error


def _refuse_other_files(path: Path, head: bytes) -> None:
    kind = kind_of(head)
    if kind is None and head.startswith(SIGNATURES + TIFF_SIGNATURES):
        return
    kind = kind or describe_file(path) or f"no image: it begins with {head[:8].hex(' ')}"
    raise DataError(f"{path}: is {kind}; save single images as PNG or TIFF (read are {READ_FORMATS})")


def places_in(path: Path) -> list[ImagePlace]:
    with open_image_file(path) as file:
        return [ImagePlace(path, page, file.pages) for page in range(file.pages)]


def grey_images(places: list[ImagePlace]) -> Iterator[ReadImage]:
    size: tuple[int, int] | None = None
    for path, together in groupby(places, key=lambda place: place.path):
        with open_image_file(path) as file:
            for place in together:
                own_size = file.size(place.page)
                size = size or own_size
                if own_size != size:
                    raise DataError(
                        f"{place}: is {own_size[0]} x {own_size[1]} pixels but the first image is "
                        f"{size[0]} x {size[1]}"
                    )
                try:
                    levels = file.read(place.page)
                except NotGreyError as error:
                    raise DataError(f"{place}: {error}") from error
                yield ReadImage(place, levels, file.is_lossy, file.stated_bits(place.page))


class _Array:
    """A NumPy array of images, read one by one; its size is known from its head, and checked."""

    def __init__(self, path: Path, stream: IO[bytes], length: int) -> None:
        self._path, self._stream = path, stream
        shape, self._dtype = _array_head(path, stream)
        self._start, self._shape = stream.tell(), shape[-2:]
        self.pages = math.prod(shape[:-2])
        self.is_lossy = False
        expected = math.prod(shape) * self._dtype.itemsize
        if length - self._start != expected:
            raise DataError(
                f"{path}: is truncated or damaged: its array of {_by(shape)} takes {expected} bytes, and "
                f"{length - self._start} are there"
            )

    def size(self, page: int) -> tuple[int, int]:
        return self._shape[1], self._shape[0]

    def stated_bits(self, page: int) -> None:
        return None

    def read(self, page: int) -> Image:
        count = math.prod(self._shape)
        length = count * self._dtype.itemsize
        self._stream.seek(self._start + page * length)
        levels = np.frombuffer(self._stream.read(length), self._dtype, count).reshape(self._shape)
        # In this computer's order of bytes.
        return levels.astype(np.uint8) if levels.dtype.itemsize == 1 else levels.astype(np.uint16)


def _only_member(path: Path, archive: zipfile.ZipFile) -> zipfile.ZipInfo:
    arrays = [member for member in archive.infolist() if member.filename.endswith(".npy")]
    if not arrays:
        raise DataError(
            f"{path}: is a ZIP archive without an array; unpack it and name the folder of its images"
        )
    if len(arrays) != 1:
        names = ", ".join(member.filename.removesuffix(".npy") for member in arrays)
        raise DataError(f"{path}: holds {len(arrays)} arrays ({names}); save one, of all images")
    return arrays[0]


def _array_head(path: Path, stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    try:
        shape, fortran, dtype = array_head(stream)
    except ValueError as error:
        raise DataError(f"{path}: is truncated or not an array of images ({error})") from error
    if dtype.kind != "u" or dtype.itemsize > 2:
        raise DataError(f"{path}: is an array of {dtype}; save the camera's own levels as uint8 or uint16")
    if len(shape) not in (2, 3, 4) or 0 in shape:
        raise DataError(
            f"{path}: is an array of {_by(shape)}; images are (height, width), (images, height, width) or "
            "(sets, steps, height, width)"
        )
    if len(shape) == 3 and LIMITS.max_axis_ratio * shape[-1] < min(shape[:2]):
        raise DataError(
            f"{path}: is an array of {_by(shape)}: its last axis seems to count images or colours; save grey "
            "images with their index first, such as np.ascontiguousarray(np.moveaxis(a, -1, 0))"
        )
    if fortran:
        raise DataError(f"{path}: is an array in column-major order; save np.ascontiguousarray of it")
    return shape, dtype


def _by(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape)) or "one number"
