"""Selection of the points of a cloud, on all processors."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fpplab.core import buffers
from fpplab.core.compiled import kernel
from fpplab.core.conventions import Mask

_BLOCK = 4096  # rows that one thread counts and copies at a time (chosen)
Runs = NDArray[np.int64]
"""First and last + 1 of neighbouring rows that are kept, and where the first of them goes, (R, 3)."""


def select_rows(arrays: Sequence[NDArray[Any]], kept: Mask) -> list[NDArray[Any]]:
    # arrays (N,); kept (N,); returns (M,)
    runs = _runs(kept)
    count = int(runs[-1, 2] + runs[-1, 1] - runs[-1, 0]) if len(runs) else 0
    chosen = []
    for values in arrays:
        selected = buffers.empty((count, *values.shape[1:]), values.dtype)
        width = values.shape[1] if values.ndim > 1 else 1
        _copy(np.ascontiguousarray(values).reshape(-1), runs, width, selected.reshape(-1))
        chosen.append(selected)
    return chosen


def places_of(kept: Mask) -> NDArray[np.int32]:
    # kept (N,); returns (N,)
    places = buffers.empty(len(kept), np.int32)
    _fill_places(_runs(kept), places)
    return places


def _runs(kept: Mask) -> Runs:
    """Rows that are kept, as runs within blocks."""
    blocks = (len(kept) + _BLOCK - 1) // _BLOCK
    counts = np.zeros((blocks, 2), np.int64)
    _find_runs(kept, counts, True, np.empty((0, 3), np.int64))
    starts = np.cumsum(counts, axis=0) - counts
    runs = np.empty((int(counts[:, 0].sum()), 3), np.int64)
    _find_runs(kept, starts, False, runs)
    return runs


@kernel(parallel=True)
def _find_runs(kept: Mask, starts: NDArray[np.int64], counting: bool, runs: Runs) -> None:
    """Count the runs and rows of each block into `starts`, or fill `runs` from there."""
    for block in prange(len(starts)):
        run, rows = (0, 0) if counting else (starts[block, 0], starts[block, 1])
        stop = min(len(kept), (block + 1) * _BLOCK)
        i = block * _BLOCK
        while i < stop:
            first = i
            while i < stop and kept[i]:
                i += 1
            if i > first:
                if not counting:
                    runs[run, 0], runs[run, 1], runs[run, 2] = first, i, rows
                run += 1
                rows += i - first
            else:
                i += 1
        if counting:
            starts[block, 0], starts[block, 1] = run, rows


@kernel(parallel=True)
def _fill_places(runs: Runs, places: NDArray[np.int32]) -> None:
    for r in prange(len(runs)):
        for i in range(runs[r, 0], runs[r, 1]):
            places[i] = runs[r, 2] + i - runs[r, 0]


@kernel(parallel=True)
def _copy(values: NDArray[Any], runs: Runs, width: int, selected: NDArray[Any]) -> None:
    for r in prange(len(runs)):
        first, to = runs[r, 0] * width, runs[r, 2] * width
        for k in range((runs[r, 1] - runs[r, 0]) * width):
            selected[to + k] = values[first + k]


@kernel(parallel=True)
def are_finite(points: NDArray[np.float32]) -> bool:
    # points (N, 3)
    wrong = 0
    for i in prange(len(points)):
        wrong += not (np.isfinite(points[i, 0]) & np.isfinite(points[i, 1]) & np.isfinite(points[i, 2]))
    return wrong == 0
