"""What an axis' codes show at each projector coordinate, as tables for the decoder of all kinds of codes.

A pixel sees `A + B p_k(u)` of the light `p_k` of image k, with A and B unknown. A table has p on a fine grid
of coordinates, blurred as the projector and the camera blur it, and the coordinates at which it is searched:
neighbouring ones that look alike are one candidate.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from fpplab.core.conventions import Axis, Floats, Lattice, axis_length
from fpplab.patterns.fringe_sets import PatternSet
from fpplab.phase.code_kernel import BATCH, BESIDE, FIGURES, LANES, Memory, measure_beside
from fpplab.phase.limits import CODES

GRID_PX = 0.125  # distance of the grid's coordinates (chosen: a sixteenth of the shortest period)


class CodeTable(NamedTuple):
    """Codes of K images on a grid of U coordinates, and C candidates, which are stretches of the grid."""

    coordinate: Floats  # (U,) px
    length: int  # of the projector along the axis in px
    unit: NDArray[np.float32]  # (K, U), codes of unit length without their means; 0 without contrast
    rows: NDArray[np.float32]  # (U, K), the same
    scale: NDArray[np.float32]  # (U,), length of each code, 0 without contrast
    slope: NDArray[np.float32]  # (U, K) per px, what offset and modulation do not explain of the derivative
    steepness: NDArray[np.float64]  # (U,), square of its length
    start: NDArray[np.int64]  # (C + 1,) index of each candidate's first grid point
    middle: NDArray[np.int64]  # (C,) index of the grid point in the middle of each candidate
    owner: NDArray[np.int64]  # (U,) candidate of each grid point
    candidates: NDArray[np.float32]  # (K, C), unit codes in the middle of each candidate
    every_second: NDArray[np.float32]  # of the candidates
    cosine: float  # of the greatest angle between a code and that in the middle of its candidate
    sine: float
    # (U,) greatest correlation of each code with one beyond the neighbours of its candidate, of `with_bounds`
    beside: Floats

    def memory(self) -> Memory:
        """Make the room that compiled functions work in."""
        images, codes = self.unit.shape
        count, last = len(self.middle), np.arange(1, len(self.start)) + BESIDE
        widest = np.max(
            self.start[np.minimum(last, count)] - self.start[np.maximum(last - 2 * BESIDE - 1, 0)]
        )
        shapes = (BATCH, images), (codes,), (1, codes), (codes,), (BATCH, int(widest) + LANES), (BATCH,)
        levels, scores, values, others, beside, means = (np.zeros(shape, np.float32) for shape in shapes)
        points, ends = np.zeros(3 * BATCH, np.int64), np.zeros((2, BATCH), np.int64)
        return Memory(levels, scores, values, others, beside, points, np.zeros(FIGURES * BATCH), means, ends)


@lru_cache(maxsize=12)
def code_table(
    sets: tuple[PatternSet, ...], axis: Axis, size: tuple[int, int], lattice: Lattice, blur_px: float
) -> CodeTable:
    """Tabulate the light of all images of an axis; `blur_px` is the standard deviation of the blur."""
    # size (width, height) px
    length = axis_length(size, axis)
    coordinate = np.arange(-0.5 + 0.5 * GRID_PX, length - 0.5, GRID_PX)
    shown = _shown(sets, coordinate, length, diamond=lattice is Lattice.DIAMOND and axis == "x")
    from scipy.ndimage import gaussian_filter1d  # which plans without codes do not need

    light = gaussian_filter1d(shown, max(blur_px, 1e-3) / GRID_PX, axis=0, mode="nearest")
    light -= light.mean(axis=1, keepdims=True)
    scale = np.linalg.norm(light, axis=1)
    scale[scale < CODES.min_contrast] = 0.0
    unit = np.where(scale > 0.0, 1.0 / np.maximum(scale, CODES.min_contrast), 0.0)[:, None] * light
    slope = np.gradient(light, GRID_PX, axis=0)
    slope -= np.sum(slope * unit, axis=1, keepdims=True) * unit
    # A candidate ends where the codes have moved by twice the angle.
    moved = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(unit, axis=0), axis=1))])
    number = np.floor(moved / (2.0 * CODES.candidate_angle))
    start = np.flatnonzero(np.diff(number, prepend=-1.0, append=np.inf))
    middle = np.searchsorted(moved, 0.5 * (moved[start[:-1]] + moved[start[1:] - 1]))
    owner = np.repeat(np.arange(len(middle)), np.diff(start))
    off = np.linalg.norm(unit - unit[middle[owner]], axis=1).max()
    f32 = np.float32
    return CodeTable(
        coordinate=coordinate,
        length=length,
        unit=_padded(unit),
        rows=unit.astype(f32),
        scale=scale.astype(f32),
        slope=slope.astype(f32),
        steepness=np.sum(slope * slope, axis=1),
        start=start,
        middle=middle,
        owner=owner,
        candidates=_padded(unit[middle]),
        every_second=_padded(unit[middle[::2]]),
        cosine=float(1.0 - 0.5 * off**2),
        sine=float(off * np.sqrt(1.0 - 0.25 * off**2)),
        beside=np.ones_like(coordinate),
    )


def with_bounds(table: CodeTable) -> CodeTable:
    """Add what shows at most pixels that only a few candidates matter."""
    table = table._replace(beside=np.empty_like(table.beside))
    measure_beside(table, table.memory())
    return table


def _padded(codes: Floats) -> NDArray[np.float32]:
    """Codes (N, K) as (K, N) with zeros behind, for ranges of whole vectors."""
    padded = np.zeros((codes.shape[1], len(codes) + LANES), np.float32)
    padded[:, : len(codes)] = codes.T
    return padded


def _shown(sets: Sequence[PatternSet], coordinate: Floats, length: int, *, diamond: bool) -> Floats:
    """Light of every image of all sets, (U, K): each mirror shows that of its centre over its whole width."""
    centres = [np.rint(coordinate)]
    if diamond:  # mirrors of every second row lie half a column further
        centres.append(np.clip(np.floor(coordinate) + 0.5, 0.5, length - 0.5))
    images = [(each, step) for each in sets for step in range(each.images)]
    rows = [[each.light(step, centre, length) for each, step in images] for centre in centres]
    return np.asarray(np.mean(rows, axis=0).T)


def nearest_codes(table: CodeTable, apart_px: float) -> tuple[float, float, float]:
    """Find the two coordinates, at least so many px apart, whose codes are nearest to each other."""
    # returns the distance, in units of the light's range after offset and modulation are fitted, and both px
    at = table.coordinate[table.middle]
    unit = table.candidates[:, : len(at)]
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


def code_uncertainty(table: CodeTable, noise: float, apart_px: float) -> tuple[float, float]:
    """Compute what noise, as a share of the modulation, makes of a coordinate that codes tell."""
    # returns the standard uncertainty, RMS along the axis in px, and the chance to be wrong by `apart_px`
    sigma, index = 0.5 * noise, np.arange(len(table.coordinate))  # the light's range is twice the modulation
    unit = table.unit[:, : len(index)].astype(np.float64)
    total, square, reach = np.zeros(len(index)), np.zeros(len(index)), int(apart_px / GRID_PX)
    for away in range(-reach, reach + 1):
        other = np.clip(index + away, 0, len(index) - 1)
        lost = table.scale**2 * (1.0 - np.clip(np.sum(unit * unit[:, other], axis=0), 0.0, 1.0) ** 2)
        weight = np.where(other == index + away, np.exp(-0.5 * lost / sigma**2), 0.0)
        total, square = total + weight, square + weight * (away * GRID_PX) ** 2
    slope = np.linalg.norm(table.slope, axis=1)
    spread, bound = square / total + GRID_PX**2 / 12.0, sigma / np.maximum(slope, 1e-9)
    variance = np.where(bound < GRID_PX, bound**2, spread)
    at, chances = table.coordinate[table.middle], []
    for k, middle in enumerate(table.middle):
        cosine = np.clip(unit[:, middle] @ unit[:, table.middle], 0.0, 1.0)[np.abs(at - at[k]) > apart_px]
        nearest = table.scale[middle] * np.sqrt(1.0 - np.max(cosine, initial=0.0) ** 2)
        chances.append(0.5 * erfc(nearest / (np.sqrt(8.0) * sigma)))
    return float(np.sqrt(variance.mean())), float(np.average(chances, weights=np.diff(table.start)))
