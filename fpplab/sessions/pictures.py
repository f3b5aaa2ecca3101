"""Pictures in PNG, TIFF, JPEG and BMP files, with their grey levels as stored."""

import re
import warnings
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import UnidentifiedImageError

from fpplab.core.conventions import Image
from fpplab.sessions.channels import WAY_OUT, NotGreyError, grey_from_channels

FORMATS = ("PNG", "TIFF", "JPEG", "BMP")
"""Formats of pictures by Pillow's names.

Pillow refuses, before it asks for memory, a picture of more than 179 million pixels.
"""
SIGNATURES = (b"\x89PNG", b"\xff\xd8\xff", b"BM")
TIFF_SIGNATURES = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")
LOSSY = ("JPEG", "MPO", "jpeg", "tiff_jpeg")
"""File formats, and compressions of TIFF files, that change grey levels."""

BITS_PER_SAMPLE, PHOTOMETRIC, PLANAR_CONFIGURATION, SAMPLE_FORMAT = 258, 262, 284, 339
NEW_SUBFILE_TYPE, SUB_IFDS, DNG_VERSION = 254, 330, 50706
WHITE_IS_ZERO, SEPARATE_PLANES = 0, 2
NUMBERS = {2: "signed integers", 3: "floating-point numbers", 5: "complex integers", 6: "complex numbers"}
CONTENTS = {"1": "1-bit pixels", "I": "32-bit integers", "CMYK": "inks (CMYK)", "P": "a palette of colours"}


class PictureFile:
    """What Pillow reads; of the files with several images only TIFF counts as such."""

    def __init__(self, path: Path, stream: IO[bytes]) -> None:
        self._path, self._picture = path, _open(stream)
        self._is_tiff = self._picture.format == "TIFF"
        self.pages = int(getattr(self._picture, "n_frames", 1)) if self._is_tiff else 1
        self._unpacked_bits = _unpacked_bits(self._picture)
        self.is_lossy = self._picture.format in LOSSY or self._picture.info.get("compression") in LOSSY

    def size(self, page: int) -> tuple[int, int]:
        self._picture.seek(page)
        return self._picture.size

    def stated_bits(self, page: int) -> int | None:
        """Depth of levels that are packed: a file of whole bytes does not tell the camera's."""
        self._picture.seek(page)
        bits = self._stored_bits()
        return bits if 8 < bits < 16 else None

    def read(self, page: int) -> Image:
        self._picture.seek(page)
        bits, mode = self._stored_bits(), self._picture.mode
        self._refuse_other_contents(bits)
        self._picture.load()
        if mode == "L" or mode.startswith("I"):
            levels: NDArray[Any] = np.asarray(self._picture)
            return levels.astype(np.uint8) if bits == 8 else levels.astype(np.uint16)
        if mode == "P":
            return self._through_palette()
        return grey_from_channels(np.asarray(self._picture) if bits == 8 else self._deep_channels(page))

    def _stored_bits(self) -> int:
        return int(max(self._tags.get(BITS_PER_SAMPLE, (1,)))) if self._is_tiff else self._unpacked_bits

    @property
    def _tags(self) -> Any:
        return getattr(self._picture, "tag_v2", {})

    def _refuse_other_contents(self, bits: int) -> None:
        mode = self._picture.mode
        if DNG_VERSION in self._tags or (self._tags.get(NEW_SUBFILE_TYPE, 0) & 1 and SUB_IFDS in self._tags):
            raise NotGreyError("is a camera's raw file (DNG or the like); export it as 16-bit grey TIFF")
        if numbers := [NUMBERS[n] for n in self._tags.get(SAMPLE_FORMAT, ()) if n in NUMBERS]:
            raise NotGreyError(f"holds {numbers[0]} of {bits} bits; {WAY_OUT}")
        is_palette = mode == "P" and not self._is_tiff  # whose palettes have 16 bits
        is_grey = (mode == "L" and bits == 8) or (mode.startswith("I") and bits in (12, 16))
        is_colour = mode in ("LA", "RGB", "RGBA", "RGBX") and bits in (8, 16)
        if not (is_palette or is_grey or is_colour):
            raise NotGreyError(f"holds {CONTENTS.get(mode, f'{bits}-bit levels ({mode})')}; {WAY_OUT}")
        if is_colour and bits > 8 and self._tags.get(PLANAR_CONFIGURATION) == SEPARATE_PLANES:
            raise NotGreyError(f"holds 16-bit colours in separate planes; {WAY_OUT}")
        if is_grey and bits > 8 and self._tags.get(PHOTOMETRIC) == WHITE_IS_ZERO:
            raise NotGreyError("is a negative (0 is white); invert its grey levels")

    def _through_palette(self) -> Image:
        palette = np.zeros((256, 3), np.uint8)
        colours = np.array(self._picture.getpalette("RGB"), np.uint8).reshape(-1, 3)
        palette[: len(colours)] = colours
        return grey_from_channels(palette[np.asarray(self._picture)])

    def _deep_channels(self, page: int) -> NDArray[Any]:
        """Colours of 16 bits, of which Pillow keeps eight."""
        content = np.memmap(self._path, np.uint8, "r")
        complete, images = cv2.imdecodemulti(content, cv2.IMREAD_UNCHANGED, range=(page, page + 1))
        if not complete or images[0].dtype != np.uint16:
            raise NotGreyError(f"holds colours of 16 bits in a form that is not read; {WAY_OUT}")
        return images[0][..., [2, 1, 0, 3][: images[0].shape[2]]]


def _open(stream: IO[bytes]) -> Pillow.Image:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # there are cameras of 150 megapixels, and odd tags beside pixels
            return Pillow.open(stream, formats=FORMATS)
    except UnidentifiedImageError:
        stream.seek(0)
        if stream.read(4) not in TIFF_SIGNATURES:
            raise
        raise NotGreyError(_describe_tiff(stream)) from None


def _unpacked_bits(picture: Pillow.Image) -> int:
    """Bits of a level by how Pillow unpacks it: L;4, or (BGR;15, 40, -1)."""
    raw_mode = picture.tile[0][3]  # type: ignore[attr-defined]
    bits = re.search(r";(\d+)", raw_mode if isinstance(raw_mode, str) else raw_mode[0])
    if bits is None:
        return 1 if picture.mode == "1" else 8
    return int(bits[1])


def _describe_tiff(stream: IO[bytes]) -> str:
    stream.seek(0)
    with tifffile.TiffFile(stream) as file:
        page = file.pages.first
        numbers = NUMBERS.get(int(page.sampleformat), "levels")
        form = f"{'big-endian ' if file.byteorder == '>' else ''}{'BigTIFF' if file.is_bigtiff else 'TIFF'}"
        compression = tifffile.COMPRESSION(page.compression).name.lower()
        return (
            f"holds {numbers} of {page.bitspersample} bits in a form that is not read ({form}, channels: "
            f"{page.samplesperpixel}, compression: {compression}); {WAY_OUT} TIFF or PNG"
        )
