"""The curve of displays by IEC 61966-2-1 (sRGB): light from pixel values and back, both uint8 of 255."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fpplab.core.conventions import Floats


def srgb_light(values: ArrayLike) -> Floats:
    v = np.asarray(values, np.float64)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def srgb_values(light: ArrayLike) -> Floats:
    """Compute the pixel values of light, the inverse of `srgb_light`."""
    x = np.asarray(light, np.float64)
    return np.where(x <= 0.04045 / 12.92, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def pixel_table(is_srgb: bool) -> NDArray[np.uint8]:
    """Tabulate the pixel value to draw for each grey level of a pattern."""
    # returns (256,)
    greys = np.arange(256) / 255.0
    return np.asarray(np.rint(255.0 * (srgb_values(greys) if is_srgb else greys)), np.uint8)


def light_table(is_srgb: bool) -> NDArray[np.uint8]:
    """Tabulate the light of each pixel value, the inverse of `pixel_table`."""
    # returns (256,)
    values = np.arange(256) / 255.0
    return np.asarray(np.rint(255.0 * (srgb_light(values) if is_srgb else values)), np.uint8)
