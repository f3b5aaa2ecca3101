"""Pixels from the bytes of a frame: rows that may be padded, and 12 bits that may be packed.

The names are those of GenICam's Pixel Format Naming Convention (PFNC).
"""

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.compiled import kernel
from fpplab.core.conventions import Image

PIXELS: dict[str, Any] = {"Mono8": np.uint8, "Mono10": np.uint16, "Mono12": np.uint16, "Mono16": np.uint16}
"""Unpacked formats, whose pixels are right-justified, least significant byte first."""
PACKED = "Mono12p"


def image_from(raw: NDArray[np.uint8], pixel_format: str, height: int, width: int, padding: int) -> Image:
    """Take the pixels out of the bytes of a frame, as a copy."""
    # returns (height, width); a Bayer filter's pixels lie as those of a camera without
    pixel_format = re.sub("^Bayer(RG|GR|GB|BG)", "Mono", pixel_format)
    if pixel_format == PACKED:
        return unpack12(raw, height, width, padding)
    if pixel_format not in PIXELS:
        raise ValueError(f"pixels of the format {pixel_format} are not known")
    dtype = np.dtype(PIXELS[pixel_format])
    rows = _rows_without_padding(raw, height, width * dtype.itemsize, padding)
    return rows.copy().view(dtype.newbyteorder("<")).astype(dtype, copy=False)


def unpack12(raw: NDArray[np.uint8], height: int, width: int, padding: int = 0) -> NDArray[np.uint16]:
    """Unpack 12-bit pixels, least significant bits first: three bytes hold two pixels."""
    # Without padding the pixels follow one another without gaps, even from row to row. With padding each row
    # begins with a byte of its own.
    # returns (height, width)
    if not padding:
        pixels: NDArray[np.uint16] = _unpack_12_bit_pixels(
            _rows_without_padding(raw, 1, _packed_bytes(height * width), 0), height * width
        )
        return pixels.reshape(height, width)
    unpacked: NDArray[np.uint16] = _unpack_12_bit_pixels(
        _rows_without_padding(raw, height, _packed_bytes(width), padding), width
    )
    return unpacked


def _packed_bytes(pixels: int) -> int:
    return (3 * pixels + 1) // 2


def _rows_without_padding(
    raw: NDArray[np.uint8], height: int, row_bytes: int, padding: int
) -> NDArray[np.uint8]:
    """A view of the rows without their padding, which the last row may lack."""
    pitch = row_bytes + padding
    if raw.size < pitch * height - padding:
        raise ValueError(f"{raw.size} bytes are too few for {height} rows of {pitch} bytes")
    return np.lib.stride_tricks.as_strided(raw, (height, row_bytes), (pitch, 1), writeable=False)


@kernel(nogil=True)
def _unpack_12_bit_pixels(rows: Any, width: int) -> Any:
    """uint16 (rows, width) from uint8 (rows, bytes); of an odd number the last pixel takes two bytes."""
    out = np.empty((rows.shape[0], width), np.uint16)
    for row in range(rows.shape[0]):
        for pair in range(width // 2):
            low, middle, high = rows[row, 3 * pair], rows[row, 3 * pair + 1], rows[row, 3 * pair + 2]
            out[row, 2 * pair] = low + (middle & 0x0F) * 256
            out[row, 2 * pair + 1] = (middle >> 4) + high * 16
        if width % 2:
            last = width // 2 * 3
            out[row, -1] = rows[row, last] + (rows[row, last + 1] & 0x0F) * 256
    return out
