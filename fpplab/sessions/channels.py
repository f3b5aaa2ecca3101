"""Pixels of several channels that are grey: all channels are equal."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Image

COLOURS = ("red", "green", "blue")
WAY_OUT = "export it as 8- or 16-bit grey"  # what to do with a picture of other levels than those of a camera


class NotGreyError(Exception):
    """What an image holds instead of grey levels, and what to do."""


def grey_from_channels(levels: NDArray[Any]) -> Image:
    """Take the one channel that others repeat; one for transparency must be opaque everywhere."""
    # levels (height, width, channels): grey or red, green, blue; then perhaps opacity
    count = levels.shape[2]
    colours = levels[..., : 3 if count >= 3 else 1]
    if count in (2, 4) and (levels[..., -1] != np.iinfo(levels.dtype).max).any():
        raise NotGreyError("is transparent in part; save it as a grey image without an alpha channel")
    first = np.ascontiguousarray(colours[..., 0])
    if any((colours[..., k] != first).any() for k in range(1, colours.shape[2])):
        difference = int(np.max(colours.max(axis=2) - colours.min(axis=2)))
        means = colours.mean(axis=(0, 1))
        listed = ", ".join(f"{name} {mean:.1f}" for name, mean in zip(COLOURS, means, strict=True))
        raise NotGreyError(
            f"is in colour: its channels differ by up to {difference} grey levels (mean {listed}); a camera "
            "interpolates colours, so record mono or raw images; if the light has one colour, save the "
            f"{COLOURS[int(means.argmax())]} channel, which has most of it, as an 8- or 16-bit grey image"
        )
    return first
