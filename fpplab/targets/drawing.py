"""Drawings of boards: rectangles and discs in mm, painted as images antialiased by area."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from fpplab.core.conventions import Floats


class InkBox(NamedTuple):
    """A rectangle in the foreground's colour, in mm in the board's frame."""

    left: float  # smallest x in mm
    top: float  # smallest y in mm
    right: float  # greatest x in mm
    bottom: float  # greatest y in mm


class InkDisc(NamedTuple):
    """A disc in the foreground's colour, in mm in the board's frame."""

    x: float  # of its centre in mm
    y: float  # of its centre in mm
    radius: float  # in mm


InkShape = InkBox | InkDisc  # a part of a board's drawing; the parts do not overlap


def covered_share(shapes: Iterable[InkShape], size_mm: tuple[float, float], px_per_mm: float) -> Floats:
    # The image's borders are the board's: where the size is not a whole number of pixels, the scale along
    # that axis is adapted.
    # size_mm (width, height) mm; returns (height, width)
    width, height = (max(round(s * px_per_mm), 1) for s in size_mm)
    scale = np.array([width / size_mm[0], height / size_mm[1]])
    share = np.zeros((height, width))
    for shape in shapes:
        if isinstance(shape, InkDisc):
            _paint_disc(share, shape, scale)
        else:
            _paint_box(share, shape, scale)
    return share


def _cells_covered(start: float, end: float, length: int) -> tuple[slice, Floats]:
    """Which of `length` unit cells an interval touches, and which share of each it covers."""
    first, last = max(int(np.floor(start)), 0), min(int(np.ceil(end)), length)
    cells = np.arange(first, last)
    return slice(first, last), np.clip(np.minimum(cells + 1, end) - np.maximum(cells, start), 0, 1)


def _paint_box(share: Floats, box: InkBox, scale: Floats) -> None:
    """Add the exact share of each pixel that a rectangle covers; scale (2,) in px per mm."""
    height, width = share.shape
    left, top, right, bottom = box
    columns, across = _cells_covered(scale[0] * left + width / 2, scale[0] * right + width / 2, width)
    rows, down = _cells_covered(scale[1] * top + height / 2, scale[1] * bottom + height / 2, height)
    share[rows, columns] += np.outer(down, across)


def _paint_disc(share: Floats, disc: InkDisc, scale: Floats) -> None:
    """Add a disc whose rim is a ramp of one pixel: the share of a pixel that a straight edge covers."""
    height, width = share.shape
    reach = disc.radius * scale + 1
    x, y = np.array([disc.x, disc.y]) * scale + (width / 2, height / 2)
    columns, _ = _cells_covered(x - reach[0], x + reach[0], width)
    rows, _ = _cells_covered(y - reach[1], y + reach[1], height)
    v, u = np.mgrid[rows, columns] + 0.5
    distance = np.hypot((u - x) / scale[0], (v - y) / scale[1]) - disc.radius
    share[rows, columns] += np.clip(0.5 - distance * scale.mean(), 0, 1)
