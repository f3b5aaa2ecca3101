"""Removal of points that lie on no surface, by four rules; what one removes is an edge to the next.

contradiction
    Light of two surfaces mixes with other phases in every fringe set: their coordinates disagree by more than
    `disagreement_max` times what noise explains.
half lit
    With a share q of its light lost a pixel measures q/2 pixels next to its ray. Its modulation is less than
    that of the surface it continues, and it lies at an edge; ink has no edge next to it.
isolated
    A connected region of fewer than `patch_min` pixels has wrong fringe orders from noise.
flying
    A point between two surfaces is across a jump in depth from more of the pixels around it than it forms a
    surface with. A majority decides, so half of the usual allowance for noise is enough for each.
"""

from dataclasses import replace
from enum import IntEnum

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fpplab.clouds import Cloud
from fpplab.clouds.pixelgrid import PixelColumnsRows, PixelGrid
from fpplab.clouds.selection import places_of
from fpplab.clouds.surfaces import is_continuous, mark_isolated_steps
from fpplab.core import buffers
from fpplab.core.compiled import kernel, kernel_part
from fpplab.core.conventions import Map, Mask
from fpplab.core.errors import DataError
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded
from fpplab.reconstruction.limits import RECONSTRUCTION_LIMITS as LIMITS

_FLYING_NOISE = np.float32(LIMITS.flying_noise_share)

Removed = NDArray[np.uint8]  # the `Rule` by which each pixel was removed, indexed [v, u]; 0 where it was kept


class Rule(IntEnum):
    """Rule by which a pixel gives no point; the values of `Decoded.removed`."""

    CONTRADICTION = 1
    HALF_LIT = 2
    ISOLATED = 3
    FLYING = 4


def apply_filter(
    decoded: Decoded, cloud: Cloud, plan: Plan, projector_size: tuple[int, int]
) -> tuple[Decoded, Cloud]:
    # projector_size (width, height) px
    rules = plan.filter
    if rules is None:
        return decoded, cloud
    grid = cloud.grid()
    removed = buffers.empty(grid.index.shape, np.uint8)
    removed[:] = 0
    if rules.disagreement_max > 0.0 and decoded.disagreement is not None:
        # Where a typical pixel's sets disagree, noise is not the limit (a response that is not linearised,
        # interreflections), and pixels are judged relative to the typical one.
        limit = np.float32(rules.disagreement_max * max(1.0, decoded.typical_disagreement))
        _contradictory(decoded.disagreement, limit, grid.w, removed)
    across, down = _surface_links(grid)
    phase_error, fringes = decoded.sigma_phase_error, plan.fringe_part
    if fringes:
        _half_lit(
            *(grid.a, grid.b, grid.w, grid.noise, across, down, decoded.modulation, decoded.sigma),
            np.empty((0, 0), np.float32) if phase_error is None else phase_error,
            # Times sigma this is the noise of the finest phase, and that of its modulation as a share of it.
            *(fringes.finest.phase_per_px(projector_size), rules.light_min, removed),
        )
    _erase(grid.w, removed)
    mark_small_regions(grid.w, across, down, rules.patch_min, removed, Rule.ISOLATED)
    _erase(grid.w, removed)
    if rules.flying:
        mark_isolated_steps(grid.a, grid.b, grid.w, grid.noise, _FLYING_NOISE, Rule.FLYING.value, removed)
        _erase(grid.w, removed)
    kept = buffers.empty(grid.count, np.bool_)
    _keep(grid.index, grid.w, kept)
    if not kept.any():
        raise DataError(
            f"the plan's filter removes all {len(cloud)} points; look at the fringes, or leave 'filter' out"
        )
    remaining = cloud.only(kept)
    _number(grid.index, grid.w, places_of(kept))
    normals = replace(grid, count=len(remaining)).normals()
    return replace(decoded, removed=removed), replace(remaining, normals=normals)


def count_removed(decoded: Decoded) -> dict[str, int | float] | None:
    if decoded.removed is None:
        return None
    counts = {rule.name.lower(): int(np.count_nonzero(decoded.removed == rule)) for rule in Rule}
    return {**counts, "share": sum(counts.values()) / int(np.count_nonzero(decoded.valid))}


def _surface_links(grid: PixelGrid) -> tuple[Mask, Mask]:
    across, down = (buffers.empty(grid.index.shape, np.bool_) for _ in range(2))
    across[:, -1] = down[-1] = False
    _link(grid.a, grid.b, grid.w, grid.noise, across, down)
    return across, down


@njit(inline="always")
def _joined(a: Map, b: Map, w: Map, noise: Map, v: int, u: int, y: int, x: int) -> bool:
    return is_continuous(
        a[y, x] - a[v, u],
        b[y, x] - b[v, u],
        w[y, x] - w[v, u],
        min(w[v, u], w[y, x]),
        noise[v, u] + noise[y, x],
    )


@kernel(parallel=True, error_model="numpy")
def _link(a: Map, b: Map, w: Map, noise: Map, across: Mask, down: Mask) -> None:
    height, width = a.shape
    for v in prange(height):
        for u in range(width - 1):
            across[v, u] = _joined(a, b, w, noise, v, u, v, u + 1)
        if v + 1 < height:
            for u in range(width):
                down[v, u] = _joined(a, b, w, noise, v, u, v + 1, u)


@kernel(parallel=True, error_model="numpy")
def _half_lit(
    a: Map,
    b: Map,
    w: Map,
    noise: Map,
    across: Mask,
    down: Mask,
    modulation: Map,
    sigma: Map,
    phase_error: Map,
    phase_per_px: float,
    light_min: float,
    removed: Removed,
) -> None:
    """Mark edge pixels of less modulation than their surface has; the image border is no edge."""
    height, width = w.shape
    for v in prange(height):
        for u in range(width):
            if np.isnan(w[v, u]):
                continue
            edge = u > 0 and not across[v, u - 1]
            edge |= u + 1 < width and not across[v, u]
            edge |= v > 0 and not down[v - 1, u]
            edge |= v + 1 < height and not down[v, u]
            if not edge:
                continue
            full = np.float32(0.0)
            for y in range(max(v - LIMITS.blur_reach_px, 0), min(v + LIMITS.blur_reach_px + 1, height)):
                for x in range(max(u - LIMITS.blur_reach_px, 0), min(u + LIMITS.blur_reach_px + 1, width)):
                    if _joined(a, b, w, noise, v, u, y, x):
                        full = max(full, modulation[y, x])
            own = modulation[v, u]
            total = np.hypot(sigma[v, u], phase_error[v, u]) if len(phase_error) > 0 else sigma[v, u]
            noisy = LIMITS.significant_sigmas * own * total * phase_per_px
            if own < light_min * full and full - own > noisy:
                removed[v, u] = Rule.HALF_LIT.value


@kernel(parallel=True)
def _contradictory(disagreement: Map, greatest: np.float32, w: Map, removed: Removed) -> None:
    for v in prange(len(w)):
        for u in range(w.shape[1]):
            if disagreement[v, u] > greatest:
                removed[v, u], w[v, u] = Rule.CONTRADICTION.value, np.nan


@kernel(parallel=True)
def _erase(w: Map, removed: Removed) -> None:
    for v in prange(len(w)):
        for u in range(w.shape[1]):
            if removed[v, u] > 0:
                w[v, u] = np.nan


@kernel(parallel=True)
def _keep(index: PixelColumnsRows, w: Map, kept: Mask) -> None:
    for v in prange(len(w)):
        for u in range(w.shape[1]):
            if index[v, u] >= 0:
                kept[index[v, u]] = not np.isnan(w[v, u])


@kernel(parallel=True)
def _number(index: PixelColumnsRows, w: Map, places: NDArray[np.int32]) -> None:
    for v in prange(len(w)):
        for u in range(w.shape[1]):
            if index[v, u] >= 0:
                index[v, u] = -1 if np.isnan(w[v, u]) else places[index[v, u]]


_BAND = 64  # rows that one thread joins in sequence (chosen)

_Numbers = NDArray[np.int32]
_RowStarts = NDArray[np.int64]


def mark_small_regions(
    w: Map, across: Mask, down: Mask, min_pixels: int, removed: NDArray[np.uint8], mark: int
) -> None:
    # w (height, width); across, down (height, width); removed (height, width)
    counts = np.zeros(len(w), np.int64)
    _find_runs(w, across, True, counts, np.empty((0, 2), np.int32))
    starts = np.concatenate([[0], np.cumsum(counts)])
    runs = np.empty((int(starts[-1]), 2), np.int32)
    _find_runs(w, across, False, starts, runs)
    parent = np.arange(len(runs), dtype=np.int32)
    _join_bands(w, down, starts, runs, parent)
    for row in range(_BAND, len(w), _BAND):
        _join_row(w, down, starts, runs, parent, row)
    _mark(starts, runs, parent, _region_sizes(runs, parent), min_pixels, removed, mark)


@kernel(parallel=True)
def _find_runs(w: Map, across: Mask, counting: bool, starts: _RowStarts, runs: _Numbers) -> None:
    for v in prange(len(w)):
        at = -1 if counting else starts[v] - 1
        was_there = False
        for u in range(w.shape[1]):
            is_there = not np.isnan(w[v, u])
            if is_there:
                if not (was_there and across[v, u - 1]):
                    at += 1
                    if not counting:
                        runs[at, 0] = u
                if not counting:
                    runs[at, 1] = u
            was_there = is_there
        if counting:
            starts[v] = at + 1


@kernel_part()
def _root(parent: _Numbers, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel()
def _join_row(w: Map, down: Mask, starts: _RowStarts, runs: _Numbers, parent: _Numbers, row: int) -> None:
    above, end = starts[row - 1], starts[row]
    for run in range(starts[row], starts[row + 1]):
        for u in range(runs[run, 0], runs[run, 1] + 1):
            if not down[row - 1, u] or np.isnan(w[row - 1, u]):
                continue
            while above < end and runs[above, 1] < u:
                above += 1
            # Usually both are in the same region already, and no root has to be searched.
            if parent[above] != parent[run]:
                first, second = _root(parent, above), _root(parent, run)
                parent[max(first, second)] = min(first, second)


@kernel(parallel=True)
def _join_bands(w: Map, down: Mask, starts: _RowStarts, runs: _Numbers, parent: _Numbers) -> None:
    """Join the runs within each band: bands share no runs, and so threads share no parents."""
    for band in prange((len(w) + _BAND - 1) // _BAND):
        for row in range(band * _BAND + 1, min((band + 1) * _BAND, len(w))):
            _join_row(w, down, starts, runs, parent, row)


@kernel()
def _region_sizes(runs: _Numbers, parent: _Numbers) -> _Numbers:
    """How many pixels the region of each run has; every run then has its root as parent."""
    sizes = np.zeros(len(runs), np.int32)
    for run in range(len(runs)):
        parent[run] = _root(parent, run)
        sizes[parent[run]] += runs[run, 1] - runs[run, 0] + 1
    return sizes


@kernel(parallel=True)
def _mark(
    starts: _RowStarts,
    runs: _Numbers,
    parent: _Numbers,
    sizes: _Numbers,
    min_pixels: int,
    removed: NDArray[np.uint8],
    mark: int,
) -> None:
    for v in prange(len(removed)):
        for run in range(starts[v], starts[v + 1]):
            if sizes[parent[run]] < min_pixels:
                removed[v, runs[run, 0] : runs[run, 1] + 1] = mark
