"""Exact nearest neighbours between large point sets on surfaces, by cells of a plane, or else a tree."""

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fpplab.core.compiled import kernel
from fpplab.core.conventions import Floats
from fpplab.core.errors import DataError

RINGS = 12  # a search that needs more rings of cells than this is answered by the tree (chosen)
_CHUNK = 4096  # queries that one thread answers in sequence (chosen)

Indices = NDArray[np.int64]
Starts = NDArray[np.int64]


def nearest_neighbours(queries: Floats, points: Floats) -> tuple[Floats, Indices]:
    # queries (Q, 3); points (P, 3); returns distance (Q,), index (Q,)
    queries, points = _require_points(queries, "queries"), _require_points(points, "points")
    centre, axes = _principal_axes(points)
    places, sought = (points - centre) @ axes, (queries - centre) @ axes
    low, high = places[:, :2].min(axis=0), places[:, :2].max(axis=0)
    area = float(np.prod(high - low))
    if not area > 0.0:
        return _by_tree(queries, points)
    cell = np.sqrt(area * 2.0 / len(points))  # two points in a cell, on average
    shape = np.maximum(np.ceil((high - low) / cell), 1.0).astype(np.int64)
    if shape.prod() > 4 * len(points):
        return _by_tree(queries, points)
    order, starts = _sort_by_cell(places, low, 1.0 / cell, shape)
    # Where a point shares its cell with 64 on average, the tree is faster than the cells.
    if float((np.diff(starts).astype(np.float64) ** 2).sum()) > 64.0 * len(points):
        return _by_tree(queries, points)
    turn, _ = _sort_by_cell(sought, low, 1.0 / cell, shape)
    distance, index = np.empty(len(queries)), np.empty(len(queries), np.int64)
    _search(
        queries=sought,
        turn=turn,
        points=places[order],
        order=order,
        starts=starts,
        low=low,
        cell=cell,
        shape=shape,
        distance=distance,
        index=index,
    )
    far = np.flatnonzero(index < 0)
    if len(far):
        distance[far], index[far] = _by_tree(queries[far], points)
    return distance, index


def _require_points(values: Floats, name: str) -> Floats:
    values = np.ascontiguousarray(values, np.float64)
    if values.ndim != 2 or values.shape[1] != 3 or len(values) == 0 or not np.isfinite(values).all():
        raise DataError(f"nearest neighbours: {name} must be finite (N, 3) with N at least 1")
    return values


def _principal_axes(points: Floats) -> tuple[Floats, Floats]:
    """Compute the centre (3,) and the axes (3, 3) in columns, that of the largest spread first."""
    centre = points.mean(axis=0)
    offsets = points[:: max(1, len(points) // 10_000)] - centre
    _, axes = np.linalg.eigh(offsets.T @ offsets)
    return centre, np.ascontiguousarray(axes[:, ::-1])


def _by_tree(queries: Floats, points: Floats) -> tuple[Floats, Indices]:
    distance, index = cKDTree(points).query(queries, workers=-1)
    return np.asarray(distance), np.asarray(index, np.int64)


@kernel(error_model="numpy")
def _sort_by_cell(places: Floats, low: Floats, per_cell: float, shape: Starts) -> tuple[Indices, Starts]:
    cells = np.empty(len(places), np.int64)
    starts = np.zeros(shape[0] * shape[1] + 1, np.int64)
    for i in range(len(places)):
        x = min(max((places[i, 0] - low[0]) * per_cell, 0.0), shape[0] - 1.0)
        y = min(max((places[i, 1] - low[1]) * per_cell, 0.0), shape[1] - 1.0)
        cells[i] = int(y) * shape[0] + int(x)
        starts[cells[i] + 1] += 1
    for k in range(1, len(starts)):
        starts[k] += starts[k - 1]
    at, order = starts[:-1].copy(), np.empty(len(places), np.int64)
    for i in range(len(places)):
        order[at[cells[i]]] = i
        at[cells[i]] += 1
    return order, starts


@njit(inline="always")
def _scan(
    px: float, py: float, pz: float, points: Floats, begin: int, end: int, best: float, best_at: int
) -> tuple[float, int]:
    for k in range(begin, end):
        dx, dy, dz = points[k, 0] - px, points[k, 1] - py, points[k, 2] - pz
        square = dx * dx + dy * dy + dz * dz
        if square < best:
            best, best_at = square, k
    return best, best_at


@kernel(parallel=True, error_model="numpy")
def _search(
    queries: Floats,
    turn: Indices,
    points: Floats,
    order: Indices,
    starts: Starts,
    low: Floats,
    cell: float,
    shape: Starts,
    distance: Floats,
    index: Indices,
) -> None:
    """Fill distance and index of each query; index -1 where `RINGS` rings do not decide."""
    nx, ny = shape[0], shape[1]
    for chunk in prange((len(queries) + _CHUNK - 1) // _CHUNK):
        for t in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, len(queries))):
            q = turn[t]
            px, py, pz = queries[q, 0], queries[q, 1], queries[q, 2]
            fx, fy = (px - low[0]) / cell, (py - low[1]) / cell
            index[q] = -1
            if not (-RINGS < fx < nx + RINGS and -RINGS < fy < ny + RINGS):
                continue
            cx, cy = int(np.floor(fx)), int(np.floor(fy))
            # Beyond ring r everything is at least r cells and this margin away; 1e-6 covers rounding.
            margin = min(fx - cx, cx + 1.0 - fx, fy - cy, cy + 1.0 - fy) - 1e-6
            best, best_at = np.inf, -1
            for ring in range(RINGS + 1):
                left, right = max(cx - ring, 0), min(cx + ring, nx - 1)
                for y in range(max(cy - ring, 0), min(cy + ring, ny - 1) + 1):
                    row = y * nx
                    if (abs(y - cy) == ring) and left <= right:
                        best, best_at = _scan(
                            px, py, pz, points, starts[row + left], starts[row + right + 1], best, best_at
                        )
                        continue
                    for x in (cx - ring, cx + ring):
                        if 0 <= x < nx:
                            at = row + x
                            best, best_at = _scan(
                                px, py, pz, points, starts[at], starts[at + 1], best, best_at
                            )
                reach = (ring + margin) * cell
                if reach > 0.0 and best <= reach * reach:
                    distance[q], index[q] = np.sqrt(best), order[best_at]
                    break
