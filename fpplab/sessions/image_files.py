"""Files that hold grey images: pictures, TIFF files of several pages, NumPy arrays."""

from __future__ import annotations

import math
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import IO, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow

from fpplab.core.archives import array_head, check_archive
from fpplab.core.conventions import Image
from fpplab.core.errors import DataError, FppError
from fpplab.core.files import open_regular
from fpplab.sessions.limits import SESSION_LIMITS as LIMITS

NPY, ZIP = b"\x93NUMPY", b"PK"
FORMATS = ("PNG", "TIFF", "JPEG", "MPO", "BMP", "PPM")
"""Formats of pictures by Pillow's names: what programs of cameras write, and readers that are used much.

Pillow refuses, before it asks for memory, a picture of more than 179 million pixels.
"""
LOSSY = ("JPEG", "MPO", "jpeg", "tiff_jpeg")
"""File formats, and compressions of TIFF files, that change grey levels."""
GREY_MODES = {"L": 8, "I;16": 16, "I;16B": 16, "I;16L": 16}
"""Grey images by Pillow's name of their kind, and the bits of a stored grey level."""
PHOTOMETRIC, WHITE_IS_ZERO = 262, 0


class ImagePlace(NamedTuple):
    """One image: a file, and which of those in it."""

    path: Path
    """The file."""
    page: int
    """Of the image, from 0."""
    pages: int
    """How many images the file holds."""

    def __str__(self) -> str:
        return f"{self.path}" if self.pages == 1 else f"{self.path} image {self.page}"

    @property
    def name(self) -> str:
        """The same without the folder."""
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
        """Return (width, height) of an image in px before it is read.

        Parameters
        ----------
        page : int
            Of the image, from 0.

        Returns
        -------
        tuple of int
            Width and height.
        """

    def read(self, page: int) -> Image:
        """Read one image.

        Parameters
        ----------
        page : int
            Of the image, from 0.

        Returns
        -------
        ndarray of uint8 or uint16, (height, width)
            Its grey levels as stored.

        Raises
        ------
        DataError
            It is not grey.
        """


@contextmanager
def open_image_file(path: Path) -> Iterator[ImageFile]:
    """Open a file of grey images: PNG, TIFF of any number of pages, JPEG, BMP, PGM, NPY, NPZ of one array.

    The first bytes decide what the file is, not its name.
    """
    try:
        with open_regular(path) as stream:
            head = stream.read(len(NPY))
            if head == NPY:
                yield _Array(path, stream, path.stat().st_size)
            elif head.startswith(ZIP):
                with zipfile.ZipFile(stream) as archive:
                    check_archive(archive, path.stat().st_size)
                    member = _only_member(path, archive)
                    with archive.open(member) as inside:
                        yield _Array(path, inside, member.file_size)
            else:
                stream.seek(0)
                with _opened(stream) as picture:
                    yield _Picture(path, picture)
    except FppError:
        raise
    except Exception as error:
        raise DataError(f"{path}: is truncated or not an image ({error})") from error


def _opened(stream: IO[bytes]) -> Pillow.Image:
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", Pillow.DecompressionBombWarning
        )  # there are cameras of 150 megapixels
        return Pillow.open(stream, formats=FORMATS)


def places_in(path: Path) -> list[ImagePlace]:
    """List the images of a file."""
    with open_image_file(path) as file:
        return [ImagePlace(path, page, file.pages) for page in range(file.pages)]


def grey_images(places: list[ImagePlace]) -> Iterator[tuple[ImagePlace, Image, bool]]:
    """Read images one after the other; all have the size of the first."""
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
                yield place, file.read(place.page), file.is_lossy


class _Picture:
    """What Pillow reads; of the files with several images only TIFF counts as such."""

    def __init__(self, path: Path, picture: Pillow.Image) -> None:
        self._path, self._picture = path, picture
        self.pages = int(getattr(picture, "n_frames", 1)) if picture.format == "TIFF" else 1
        self.is_lossy = picture.format in LOSSY or picture.info.get("compression") in LOSSY

    def size(self, page: int) -> tuple[int, int]:
        self._picture.seek(page)
        return self._picture.size

    def read(self, page: int) -> Image:
        self._picture.seek(page)
        self._picture.load()
        mode, place = self._picture.mode, ImagePlace(self._path, page, self.pages)
        if mode not in GREY_MODES:
            raise DataError(
                f"{place}: is not a grey image (its mode is {mode}); convert it to one grey channel"
            )
        tags = getattr(self._picture, "tag_v2", {})
        if GREY_MODES[mode] == 16 and tags.get(PHOTOMETRIC) == WHITE_IS_ZERO:
            raise DataError(f"{place}: is a negative (0 is white); invert its grey levels")
        return _raw(np.asarray(self._picture))


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

    def read(self, page: int) -> Image:
        count = math.prod(self._shape)
        length = count * self._dtype.itemsize
        self._stream.seek(self._start + page * length)
        levels = np.frombuffer(self._stream.read(length), self._dtype, count).reshape(self._shape)
        return _raw(levels)


def _raw(levels: NDArray[Any]) -> Image:
    """Levels in this computer's order of bytes."""
    return levels.astype(np.uint8) if levels.dtype.itemsize == 1 else levels.astype(np.uint16)


def _only_member(path: Path, archive: zipfile.ZipFile) -> zipfile.ZipInfo:
    """Give the one array of an NPZ file."""
    arrays = [member for member in archive.infolist() if member.filename.endswith(".npy")]
    if len(arrays) != 1:
        names = ", ".join(member.filename.removesuffix(".npy") for member in arrays) or "none"
        raise DataError(f"{path}: holds {len(arrays)} arrays ({names}); save one, of all images")
    return arrays[0]


def _array_head(path: Path, stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape (…, height, width) and type of an array that is one of grey images, from its first bytes."""
    stream.seek(0)
    try:
        shape, fortran, dtype = array_head(stream)
    except ValueError as error:
        raise DataError(f"{path}: is truncated or not an array of images ({error})") from error
    if dtype.kind != "u" or dtype.itemsize > 2:
        raise DataError(f"{path}: is an array of {dtype}; grey levels are uint8 or uint16")
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
