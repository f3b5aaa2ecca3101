"""Connected regions of pixels that are too small: runs in rows, joined in bands on all processors."""

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fpplab.core.compiled import kernel, kernel_part
from fpplab.core.conventions import Map, Mask

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
