"""From bit planes to the light that leaves the lens."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from drivers.dlp4500.sequence import bit_planes
from fpplab.core.conventions import Floats

FlashImage = NDArray[np.uint8]
"""(height, width, 3): the planes of green, red and blue."""


@dataclass(frozen=True, eq=False)
class ProjectedLight:
    """A pattern on the mirrors and the LEDs behind it.

    content: the image whose planes are shown, by depth, number and inversion. levels: 0 to 1 by colour of the
    LEDs that are on. image: the flash image or video frame that it is, None in video mode.
    """

    content: FlashImage
    depth: int
    number: int
    inverted: bool
    levels: Mapping[str, float]
    image: int | None

    @cached_property
    def grey(self) -> NDArray[np.uint8]:
        """uint8 (height, width), 255 for a mirror that is always on."""
        return grey(self.content, self.depth, self.number, self.inverted)

    def brightness(self) -> Floats:
        """(height, width), 1 where all three LEDs are fully on."""
        return self.grey * (sum(self.levels.values()) / (3 * 255.0))


def grey(image: FlashImage, depth: int, number: int, inverted: bool) -> NDArray[np.uint8]:
    """A pattern of an image as grey levels 0 … 255, uint8 (height, width).

    Raises `ValueError` for a depth or number that there is not.
    """
    full = (1 << depth) - 1
    values = _values(image, bit_planes(depth, number), full)
    scale = np.rint(np.arange(full + 1) * (255.0 / full)).astype(np.uint8)
    return np.asarray((scale[::-1] if inverted else scale)[values], np.uint8)


def _values(image: FlashImage, wanted: range, full: int) -> NDArray[np.uint8]:
    """The numbers that neighbouring planes are, in one colour or over two."""
    if not wanted:
        return np.zeros(image.shape[:2], np.uint8)
    first, shift = divmod(wanted.start, 8)
    low = image[..., first] >> shift
    if wanted.stop <= 8 * (first + 1):
        return np.asarray(low & full, np.uint8)
    return np.asarray((low | image[..., first + 1] << (8 - shift)) & full, np.uint8)
