"""Compression of pattern images as stored in flash: four lines, run lengths, or none.

An image is uint8 (height, width, 3), its pixels in the order stored.

Source: TI's DLPC350 client.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fpplab.core.compiled import kernel

ImageBytes = NDArray[np.uint8]

STORED_ROWS = 4  # rows that the four-line compression stores (TI's client)
MAX_RUN = 255  # pixels that one count byte can announce (derived: 8 bits)


class Compression(IntEnum):
    """Compression of an image, as its header states it."""

    NONE = 0
    RUN_LENGTH = 1
    FOUR_LINE = 4


@dataclass(frozen=True)
class CompressedImage:
    """The stored bytes of one image, without header."""

    method: Compression  # how the image is compressed
    data: bytes  # the stored bytes


def compress(image: ImageBytes) -> CompressedImage:
    """Compress an image without loss in the shortest way."""
    # Four lines are stored where every row is repeated four rows further down, as it is for vertical fringes
    # on either lattice; else run lengths, where they are shorter than the image itself.
    # image (height, width, 3)
    if repeats_every_four_lines(image):
        return CompressedImage(Compression.FOUR_LINE, image[:STORED_ROWS].tobytes())
    runs = encode_run_lengths(image)
    if len(runs) < image.nbytes:
        return CompressedImage(Compression.RUN_LENGTH, runs)
    return CompressedImage(Compression.NONE, image.tobytes())


def repeats_every_four_lines(image: ImageBytes) -> bool:
    # image (height, width, 3)
    return len(image) > STORED_ROWS and np.array_equal(image[STORED_ROWS:], image[:-STORED_ROWS])


def encode_run_lengths(image: ImageBytes) -> bytes:
    # A byte n of 1 to 255 means that the pixel after it is repeated n times; 0 and n of 2 to 255 that n
    # pixels follow literally; 0, 0 ends a row and is padded with zeros to a multiple of 4 bytes; 0, 1 ends
    # the image and is padded to a multiple of 16 bytes.
    # image (height, width, 3)
    height, width, _ = image.shape
    longest_row = 4 * width + 5  # each pixel a run of its own, the end of the row and its padding
    stored = np.zeros(height * longest_row + 17, np.uint8)
    return stored[: _compress_into(np.ascontiguousarray(image), stored)].tobytes()


@kernel()
def _compress_into(image: ImageBytes, stored: ImageBytes) -> int:
    """Fill `stored`, which is all zeros, and return how many bytes of it are used."""
    at = 0
    for row in image:
        column = 0
        while column < len(row):
            run = _run_length(row, column)
            single = 0
            while single < MAX_RUN and column + single < len(row) and _run_length(row, column + single) == 1:
                single += 1
            if single > 1:
                stored[at + 1] = single
                at = _copy_pixels(row, column, single, stored, at + 2)
                column += single
            else:
                stored[at] = run
                at = _copy_pixels(row, column, 1, stored, at + 1)
                column += run
        at = (at + 2 + 3) // 4 * 4
    stored[at + 1] = 1
    return (at + 2 + 15) // 16 * 16


@njit(inline="always")
def _run_length(row: ImageBytes, column: int) -> int:
    """Count how often the pixel at `column` is repeated from there on, at most MAX_RUN."""
    end = column + 1
    while end < len(row) and end - column < MAX_RUN and _same(row, column, end):
        end += 1
    return end - column


@njit(inline="always")
def _same(row: ImageBytes, a: int, b: int) -> bool:
    return bool(row[a, 0] == row[b, 0] and row[a, 1] == row[b, 1] and row[a, 2] == row[b, 2])


@njit(inline="always")
def _copy_pixels(row: ImageBytes, column: int, count: int, stored: ImageBytes, stored_offset: int) -> int:
    """Copy `count` pixels and return where the next byte goes."""
    for i in range(column, column + count):
        for plane in range(3):
            stored[stored_offset] = row[i, plane]
            stored_offset += 1
    return stored_offset
