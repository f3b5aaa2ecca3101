"""Frames of a camera with a Bayer filter, which stay as they are: a pixel has the light of its own colour."""

from collections.abc import Sequence
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Image, Map

Bayer = Literal["RGGB", "GRBG", "GBRG", "BGGR"]
"""Colours of the first two pixels of the first row, and then of the second row."""

_MEAN = np.array([0.25, 0.5, 0.25], np.float32)
"""Weights along each axis with which a mean has equally much of all four places of the pattern (derived)."""
_TILE = 16
"""Pixels of one place along each side of a tile (chosen: edges take less than half of most tiles)."""
_MIN_PIXELS = 32  # of one place in a tile that tell its share (chosen)


def without_mosaic(levels: NDArray[Any]) -> Map:
    """Divide each pixel by the share that its colour has nearby, so that neighbours can be compared."""
    # The share is a median over tiles, which edges do not change. A part's own colours remain within a tile
    # of their borders. levels (height, width), NaN where not known.
    values = np.asarray(levels, np.float32)
    around, even = cv2.sepFilter2D(values, -1, _MEAN, _MEAN), np.empty_like(values)
    for place in _PLACES:
        shares = np.full(values[place].shape, np.nan, np.float32)
        np.divide(values[place], around[place], out=shares, where=around[place] > 0)
        even[place] = values[place] / _by_tile(shares)
    return even


_PLACES = tuple((slice(v, None, 2), slice(u, None, 2)) for v in (0, 1) for u in (0, 1))


def _by_tile(shares: Map) -> Map:
    """Medians of tiles, interpolated between their centres; the whole image's where a tile has too few."""
    height, width = shares.shape
    rows, columns = -(-height // _TILE), -(-width // _TILE)
    padded = np.full((rows * _TILE, columns * _TILE), np.nan, np.float32)
    padded[:height, :width] = shares
    tiles = padded.reshape(rows, _TILE, columns, _TILE).swapaxes(1, 2).reshape(rows, columns, -1)
    known = shares[np.isfinite(shares)]
    medians = np.full((rows, columns), np.median(known) if known.size else 1.0, np.float32)
    usable = np.count_nonzero(np.isfinite(tiles), axis=-1) >= _MIN_PIXELS
    if usable.any():
        medians[usable] = np.nanmedian(tiles[usable], axis=-1)
    whole = cv2.resize(medians, padded.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.maximum(whole[:height, :width], np.float32(1e-3))


def colours_at(levels: Map, bayer: Bayer, pixels: NDArray[np.int32]) -> Floats:
    """Take red, green and blue from the nearest pixels of each colour: for colour, never for geometry."""
    # levels (height, width); pixels (N, 2) as (u, v); returns (N, 3)
    channels: list[Map] = []
    for colour in "RGB":
        weight = np.zeros(levels.shape, np.float32)
        for place, letter in zip(_PLACES, bayer, strict=True):
            weight[place] = letter == colour
        total, count = (cv2.sepFilter2D(part, -1, _MEAN, _MEAN) for part in (levels * weight, weight))
        channels.append((total / count)[pixels[:, 1], pixels[:, 0]])
    return np.stack(channels, axis=1).astype(np.float64)


def white_levels(colours: Floats) -> tuple[float, float, float]:
    """Relative levels of red, green and blue of the brighter half, taken for white; mean over a mosaic 1."""
    # colours (N, 3)
    level = colours @ [0.25, 0.5, 0.25]
    red, green, blue = colours[level >= np.median(level)].sum(axis=0)
    mean = 0.25 * (red + 2.0 * green + blue)
    return float(red / mean), float(green / mean), float(blue / mean)


def colour_factors(shape: tuple[int, int], bayer: Bayer, factors: tuple[float, float, float]) -> Map:
    """Give each pixel the factor of its colour."""
    # factors of red, green and blue; returns (height, width)
    by_pixel = np.empty(shape, np.float32)
    for place, letter in zip(_PLACES, bayer, strict=True):
        by_pixel[place] = factors["RGB".index(letter)]
    return by_pixel


def mean_of(frames: Sequence[Image], scale: float) -> Map:
    """Mean of frames, in grey levels."""
    total: Map = np.zeros(frames[0].shape, np.float32)
    for frame in frames:
        total += frame
    total *= np.float32(scale / len(frames))
    return total
