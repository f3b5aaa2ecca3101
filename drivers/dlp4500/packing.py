"""Packing of patterns into the 24 bit planes of an image, for flash and video port."""

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from drivers.dlp4500.index import shown_image
from drivers.dlp4500.sequence import SIZE, Slot, bit_planes, pattern_numbers
from fpplab.patterns.fringes import Pattern

Planes = NDArray[np.uint8]
"""uint8 (1140, 912, 3): the bit planes of green, red and blue, in the order of their numbers."""


def assign_slots(patterns: Sequence[Pattern], max_patterns: int) -> list[Slot]:
    """Assign patterns to frames in their order, as many of equal bit depth to a frame as it holds."""
    slots: list[Slot] = []
    for pattern in patterns:
        image, number, bits = -1, 0, pattern.bit_depth
        if slots:
            image, number = slots[-1].image, slots[-1].number + 1
        if not slots or bits != slots[-1].bits or number == min(max_patterns, len(pattern_numbers(bits))):
            image, number = image + 1, 0
        slots.append(Slot(image, number, bits, pattern.led))
    return slots


def pack_images(patterns: Sequence[Pattern], slots: Sequence[Slot]) -> Iterator[Planes]:
    width, height = SIZE
    placed = zip(patterns, slots, strict=True)
    for _, group in groupby(placed, key=lambda pair: pair[1].image):
        image = np.zeros((height, width, 3), np.uint8)
        for pattern, slot in group:
            _write_levels(image, shown_image(pattern), slot)
        yield image


def _write_levels(image: Planes, levels: NDArray[np.uint8], slot: Slot) -> None:
    """Write grey levels into the bit planes of one colour, or of two adjacent ones."""
    planes = bit_planes(slot.bits, slot.number)
    colour, shift = divmod(planes.start, 8)
    full = (1 << slot.bits) - 1
    bits = np.rint(np.arange(256) * (full / 255.0)).astype(np.uint16) << shift
    image[..., colour] |= (bits & 0xFF).astype(np.uint8)[levels]
    if planes.stop > 8 * (colour + 1):
        image[..., colour + 1] |= (bits >> 8).astype(np.uint8)[levels]
