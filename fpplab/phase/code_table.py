"""What an axis' codes show at each projector coordinate, as tables for the decoder of all kinds of codes.

A pixel sees `A + B p_k(u)` of the light `p_k` of image k, with A and B unknown. A table has p on a fine grid
of coordinates, blurred as the projector and the camera blur it, and the coordinates at which it is searched:
neighbouring ones that look alike are one candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from fpplab.core.conventions import Axis, Floats, Lattice, axis_length
from fpplab.patterns.fringe_sets import PatternSet
from fpplab.phase.limits import CODES

GRID_PX = 0.125  # distance of the grid's coordinates (chosen: a sixteenth of the shortest period)


@dataclass(frozen=True, eq=False)
class CodeTable:
    """Codes of K images on a grid of U coordinates, and C candidates among them."""

    coordinate: Floats  # (U,) px
    length: int  # of the projector along the axis in px
    light: NDArray[np.float32]  # (U, K), without the mean of each code
    scale: NDArray[np.float32]  # (U,), length of each code, 0 where its images are equal
    slope: NDArray[np.float32]  # (U, K) per px, what offset and modulation do not explain of the derivative
    start: NDArray[np.int64]  # (C + 1,) index of each candidate's first grid point
    middle: NDArray[np.int64]  # (C,) index of the grid point in the middle of each candidate
    candidates: NDArray[np.float32]  # (K, C), codes of unit length there


@lru_cache(maxsize=8)
def code_table(
    sets: tuple[PatternSet, ...], axis: Axis, size: tuple[int, int], lattice: Lattice, blur_px: float
) -> CodeTable:
    """Tabulate the light of all images of an axis; `blur_px` is the standard deviation of the blur."""
    # size (width, height) px
    length = axis_length(size, axis)
    coordinate = np.arange(-0.5 + 0.5 * GRID_PX, length - 0.5, GRID_PX)
    shown = _shown(sets, coordinate, length, diamond=lattice is Lattice.DIAMOND and axis == "x")
    light = gaussian_filter1d(shown, max(blur_px, 1e-3) / GRID_PX, axis=0, mode="nearest")
    start = _boundaries(light)
    light -= light.mean(axis=1, keepdims=True)
    scale = np.linalg.norm(light, axis=1)
    unit = light / np.maximum(scale, CODES.min_contrast)[:, None]
    slope = np.gradient(light, GRID_PX, axis=0)
    slope -= np.sum(slope * unit, axis=1, keepdims=True) * unit
    middle = (start[:-1] + start[1:] - 1) // 2
    f32 = np.float32
    return CodeTable(
        coordinate=coordinate,
        length=length,
        light=light.astype(f32),
        scale=np.where(scale < CODES.min_contrast, 0.0, scale).astype(f32),
        slope=slope.astype(f32),
        start=start,
        middle=middle,
        candidates=np.ascontiguousarray(unit[middle].T, f32),
    )


def _shown(sets: Sequence[PatternSet], coordinate: Floats, length: int, *, diamond: bool) -> Floats:
    """Light of every image of all sets, (U, K): each mirror shows that of its centre over its whole width."""
    centres = [np.rint(coordinate)]
    if diamond:  # mirrors of every second row lie half a column further
        centres.append(np.clip(np.floor(coordinate) + 0.5, 0.5, length - 0.5))
    images = [(each, step) for each in sets for step in range(each.images)]
    rows = [[each.light(step, centre, length) for each, step in images] for centre in centres]
    return np.asarray(np.mean(rows, axis=0).T)


def _boundaries(light: Floats) -> NDArray[np.int64]:
    """Where a candidate ends: where any image has changed by more than the tolerance since it began."""
    changes = np.abs(np.diff(light, axis=0)).max(axis=1)
    start, passed = [0], 0.0
    for k, change in enumerate(changes.tolist(), 1):
        passed += change
        if passed > CODES.candidate_step:
            start.append(k)
            passed = 0.0
    return np.array([*start, len(light)], np.int64)


def nearest_codes(table: CodeTable, apart_px: float) -> tuple[float, float, float]:
    """Find the two coordinates at least so far apart whose codes are nearest to each other.

    Parameters
    ----------
    table : CodeTable
        Of the sets.
    apart_px : float
        Least distance in px of the coordinates.

    Returns
    -------
    distance : float
        Of the codes, in units of the light's range, after offset and modulation are fitted; infinite where
        no coordinates are so far apart.
    first, second : float
        The coordinates in px.
    """
    at, unit = table.coordinate[table.middle], table.candidates
    scale = table.scale[table.middle]
    worst = (np.inf, np.nan, np.nan)
    for k in range(len(at)):
        rest = at > at[k] + apart_px
        if not rest.any():
            break
        cosine = np.clip(unit[:, k] @ unit[:, rest], 0.0, 1.0)
        distance = scale[k] * np.sqrt(1.0 - cosine**2)
        n = int(np.argmin(distance))
        if distance[n] < worst[0]:
            worst = (float(distance[n]), float(at[k]), float(at[rest][n]))
    return worst
