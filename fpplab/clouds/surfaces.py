"""Surfaces that a camera sees: whether two points lie on one, and the normal of each point.

Two points do when the step in depth between them is no more than a surface inclined by `STEEPEST_DEG` would
show between their rays, plus `NOISE_SIGMAS` of the step's own noise. In w = 1/z over the slopes (a, b):
`|Δw| <= w (tan(STEEPEST) |Δ(a, b)| + NOISE_SIGMAS σ(Δz)/z)`.
"""

from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fpplab.core.compiled import kernel, kernel_part
from fpplab.core.conventions import Map

STEEPEST_DEG = 80.0  # greatest inclination of a surface to the image plane (chosen: as a comparison counts)
NOISE_SIGMAS = 4.0  # standard deviations of noise that are allowed in a step within one surface (chosen)
NORMAL_REACH = 2
"""A point's normal is that of the plane through it and its eight neighbours this many px away (chosen)."""

_STEEPEST = np.float32(np.tan(np.radians(STEEPEST_DEG)))
_NONE, _ONE = np.float32(0.0), np.float32(1.0)
_u = np.uintp
_PART = 512  # pixels of a row that are copied into the cache at a time (chosen)
# Rows of the buffer: a, b, w and noise of three rows of the image, and the normal's components.
_ROW = _PART + 48
_B, _W, _NOISE, _HERE = _u(_ROW), _u(2 * _ROW), _u(3 * _ROW), _u(4 * _ROW + NORMAL_REACH)
_ACROSS, _DOWN, _ALONG = _u(12 * _ROW), _u(13 * _ROW), _u(14 * _ROW)

_NOTHING: Any = (_NONE,) * 9  # count, sums, and sums of products of the differences of a, b and w


@njit(inline="always")
def is_continuous(da: float, db: float, dw: float, w: float, noise: float) -> bool:
    return bool(abs(dw) <= w * (_STEEPEST * np.sqrt(da * da + db * db) + noise))


@kernel(parallel=True, error_model="numpy")
def surface_normals(
    index: NDArray[np.int32], a: Map, b: Map, w: Map, noise: Map, normals: NDArray[np.float32]
) -> None:
    # index (height, width); a, b, w, noise (height, width); normals (N, 3)
    height, width = index.shape
    for v in prange(height):
        work = np.empty(15 * _ROW, np.float32)
        for first in range(0, width, _PART):
            n = min(_PART, width - first)
            _copy_around(a, b, w, noise, v, first, n, NORMAL_REACH, work)
            _fit_planes(work, n)
            for j in range(n):
                at, i = index[v, first + j], _u(j)
                if at >= 0:
                    normals[at, 0], normals[at, 1] = work[i + _ACROSS], work[i + _DOWN]
                    normals[at, 2] = work[i + _ALONG]


@kernel_part()
def _copy_around(
    a: Map, b: Map, w: Map, noise: Map, v: int, first: int, n: int, reach: int, work: NDArray[np.float32]
) -> None:
    """Copy a part of a row with `reach` more pixels at both ends, and of the rows `reach` above and below."""
    height, width = w.shape
    work[:] = np.nan
    low, high = max(first - reach, 0), min(first + n + reach, width)
    for k in range(3):
        y = v + (k - 1) * reach
        if 0 <= y < height:
            to = 4 * k * _ROW + reach - first
            for u in range(low, high):
                work[to + u], work[to + u + _ROW] = a[y, u], b[y, u]
                work[to + u + 2 * _ROW], work[to + u + 3 * _ROW] = w[y, u], noise[y, u]


@kernel(parallel=True, error_model="numpy")
def mark_isolated_steps(
    a: Map, b: Map, w: Map, noise: Map, noise_share: np.float32, mark: int, marked: NDArray[np.uint8]
) -> None:
    """Mark the points that lie on one surface with fewer than half of their eight neighbours."""
    # `noise_share` of the allowance for noise counts.
    # a, b, w, noise, marked (height, width)
    height, width = w.shape
    for v in prange(height):
        work = np.empty(15 * _ROW, np.float32)
        for first in range(0, width, _PART):
            n = min(_PART, width - first)
            _copy_around(a, b, w, noise, v, first, n, 1, work)
            _vote(work, n, noise_share)
            for j in range(n):
                if work[_u(j) + _ACROSS] < 0.0:
                    marked[v, first + j] = mark


@kernel_part(error_model="numpy", fastmath={"contract"})
def _vote(work: Any, pixel_count: int, noise_share: Any) -> None:
    for j in range(pixel_count):
        i = _u(j)
        k = i + _u(4 * _ROW + 1)
        here = work[k], work[k + _B], work[k + _W], work[k + _NOISE]
        votes = _vote_of(here, work, i, noise_share) + _vote_of(here, work, i + _u(1), noise_share)
        votes += _vote_of(here, work, i + _u(2), noise_share) + _vote_of(here, work, k - _u(1), noise_share)
        below = i + _u(8 * _ROW)
        votes += _vote_of(here, work, k + _u(1), noise_share) + _vote_of(here, work, below, noise_share)
        votes += _vote_of(here, work, below + _u(1), noise_share)
        work[i + _ACROSS] = votes + _vote_of(here, work, below + _u(2), noise_share)


@kernel_part(error_model="numpy", fastmath={"contract"})
def _vote_of(here: Any, work: Any, k: Any, noise_share: Any) -> Any:
    """1 of a neighbour on the surface of the pixel, -1 of one beside it, 0 where either has no point."""
    w = work[k + _W]
    da, db, dw = work[k] - here[0], work[k + _B] - here[1], w - here[2]
    joined = is_continuous(da, db, dw, min(here[2], w), noise_share * (here[3] + work[k + _NOISE]))
    vote = _ONE if joined else -_ONE
    return vote if dw == dw else _NONE  # NaN differs from itself


@kernel_part(error_model="numpy", fastmath={"contract"})
def _with_neighbour(sums: Any, here: Any, work: Any, k: Any) -> Any:
    """Add a neighbour, if it lies on the surface of the pixel."""
    da, db, dw = work[k] - here[0], work[k + _B] - here[1], work[k + _W] - here[2]
    same = is_continuous(da, db, dw, here[2], here[3] + work[k + _NOISE])  # false where there is no point
    da, db, dw = da if same else _NONE, db if same else _NONE, dw if same else _NONE
    count, sa, sb, sw, saa, sab, sbb, saw, sbw = sums
    count, sa, sb, sw = count + (_ONE if same else _NONE), sa + da, sb + db, sw + dw
    return count, sa, sb, sw, saa + da * da, sab + da * db, sbb + db * db, saw + da * dw, sbw + db * dw


@kernel_part(error_model="numpy", fastmath={"contract"})
def _fit_planes(work: Any, pixel_count: int) -> None:
    """Fit a plane to each pixel of a part of a row."""
    for j in range(pixel_count):
        i = _u(j)
        k = i + _HERE
        here = work[k], work[k + _B], work[k + _W], work[k + _NOISE]
        # As a loop they would not be computed for several pixels at once.
        sums = _with_neighbour(_NOTHING, here, work, i)
        sums = _with_neighbour(sums, here, work, i + _u(NORMAL_REACH))
        sums = _with_neighbour(sums, here, work, i + _u(2 * NORMAL_REACH))
        sums = _with_neighbour(sums, here, work, i + _u(4 * _ROW))
        sums = _with_neighbour(sums, here, work, i + _u(4 * _ROW + NORMAL_REACH))
        sums = _with_neighbour(sums, here, work, i + _u(4 * _ROW + 2 * NORMAL_REACH))
        sums = _with_neighbour(sums, here, work, i + _u(8 * _ROW))
        sums = _with_neighbour(sums, here, work, i + _u(8 * _ROW + NORMAL_REACH))
        sums = _with_neighbour(sums, here, work, i + _u(8 * _ROW + 2 * NORMAL_REACH))
        count, sa, sb, sw, saa, sab, sbb, saw, sbw = sums
        ma, mb = sa / count, sb / count
        caa, cab, cbb, caw, cbw = saa - sa * ma, sab - sa * mb, sbb - sb * mb, saw - sw * ma, sbw - sw * mb
        determinant = caa * cbb - cab * cab
        alpha, beta = (caw * cbb - cbw * cab) / determinant, (cbw * caa - caw * cab) / determinant
        gamma = here[2] + sw / count - alpha * (here[0] + ma) - beta * (here[1] + mb)
        # (α, β, γ)·X = 1 > 0 on the plane: it points away from the camera at the origin.
        scale = -_ONE / np.sqrt(alpha * alpha + beta * beta + gamma * gamma)
        # Neighbours lie on a line when the squared correlation of their places is within 0.001 of 1.
        spans = determinant > np.float32(1e-3) * caa * cbb
        work[i + _ACROSS] = alpha * scale if spans else _NONE
        work[i + _DOWN] = beta * scale if spans else _NONE
        work[i + _ALONG] = gamma * scale if spans else _NONE
