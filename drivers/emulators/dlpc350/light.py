"""From the bit planes of an image to the light that leaves the lens."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from drivers.dlp4500.sequence import bit_planes
from fpplab.core.conventions import Floats

GAMMA_TABLE = np.rint(255.0 * (np.arange(256) / 255.0) ** 2.2).astype(np.uint8)
"""What gamma correction makes of grey levels (chosen: TI does not tell its tables)."""

FlashImage = NDArray[np.uint8]  # (height, width, 3), uint8: the eight bit planes each of green, red and blue


@dataclass(frozen=True, eq=False)
class ProjectedLight:
    """A pattern on the mirrors and the LEDs that illuminate them."""

    content: FlashImage  # the image of whose bit planes the pattern consists
    depth: int  # bits of the pattern
    number: int  # index of the pattern among those of its depth in the image
    inverted: bool  # whether grey levels are inverted
    levels: Mapping[str, float]  # levels 0 … 1 of the LEDs that are on, by colour
    image: int | None  # index of the flash image or video frame; None in video mode
    gamma: bool = False  # whether gamma correction bends the grey levels

    @cached_property
    def grey(self) -> NDArray[np.uint8]:
        """Grey levels, uint8 (height, width), 255 for a mirror that is always on."""
        grey = grey_levels(self.content, self.depth, self.number, self.inverted)
        return GAMMA_TABLE[grey] if self.gamma else grey

    def brightness(self) -> Floats:
        # returns (height, width)
        return self.grey * (sum(self.levels.values()) / (3 * 255.0))


def grey_levels(image: FlashImage, depth: int, number: int, inverted: bool) -> NDArray[np.uint8]:
    """Compute the grey levels 0 … 255 of a pattern."""
    # image (height, width, 3); returns (height, width)
    full = (1 << depth) - 1
    values = _plane_values(image, bit_planes(depth, number), full)
    scale = np.rint(np.arange(full + 1) * (255.0 / full)).astype(np.uint8)
    return np.asarray((scale[::-1] if inverted else scale)[values], np.uint8)


def _plane_values(image: FlashImage, planes: range, full: int) -> NDArray[np.uint8]:
    """Read the values of neighbouring bit planes, which lie in one colour or in two."""
    if not planes:
        return np.zeros(image.shape[:2], np.uint8)
    first, shift = divmod(planes.start, 8)
    low = image[..., first] >> shift
    if planes.stop <= 8 * (first + 1):
        return np.asarray(low & full, np.uint8)
    return np.asarray((low | image[..., first + 1] << (8 - shift)) & full, np.uint8)
