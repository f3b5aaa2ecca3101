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
_PART = 512  # pixels of a row whose sums are kept in the cache at a time (chosen)

_STEEPEST = np.float32(np.tan(np.radians(STEEPEST_DEG)))
_u = np.uintp
# Rows of the buffer: count, sums, and sums of products of the differences of a, b and w.
_SA, _SB, _SW, _SAA, _SAB, _SBB, _SAW, _SBW = (_u(k * (_PART + 16)) for k in range(1, 9))
_ROWS = 9 * (_PART + 16)


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
        sums = np.empty(_ROWS)
        for first in range(0, width, _PART):
            n = min(_PART, width - first)
            sums[:] = 0.0
            for y in range(v - NORMAL_REACH, v + NORMAL_REACH + 1, NORMAL_REACH):
                for shift in range(-NORMAL_REACH, NORMAL_REACH + 1, NORMAL_REACH):
                    low, high = max(0, -shift - first), min(n, width - shift - first)
                    if 0 <= y < height and low < high:
                        here = slice(first + low, first + high)
                        window = slice(first + low + shift, first + high + shift)
                        _add_neighbours(
                            *(a[v, here], b[v, here], w[v, here], noise[v, here]),
                            *(a[y, window], b[y, window], w[y, window], noise[y, window]),
                            *(sums[low:], high - low),
                        )
            _solve_planes(index[v, first:], a[v, first:], b[v, first:], w[v, first:], sums, n, normals)


@kernel_part(error_model="numpy")
def _add_neighbours(
    a0: Any, b0: Any, w0: Any, noise0: Any, a: Any, b: Any, w: Any, noise: Any, sums: Any, pixel_count: int
) -> None:
    """Add the neighbours of n pixels that lie on the surface of these."""
    zero = np.float32(0)
    for j in range(pixel_count):
        i = _u(j)
        da, db, dw = a[i] - a0[i], b[i] - b0[i], w[i] - w0[i]
        # False where there is no point.
        same = is_continuous(da, db, dw, w0[i], noise0[i] + noise[i])
        da, db, dw = da if same else zero, db if same else zero, dw if same else zero
        sums[i] += 1.0 if same else 0.0
        sums[i + _SA] += da
        sums[i + _SB] += db
        sums[i + _SW] += dw
        sums[i + _SAA] += da * da
        sums[i + _SAB] += da * db
        sums[i + _SBB] += db * db
        sums[i + _SAW] += da * dw
        sums[i + _SBW] += db * dw


@kernel_part(error_model="numpy")
def _solve_planes(index: Any, a0: Any, b0: Any, w0: Any, sums: Any, pixel_count: int, normals: Any) -> None:
    for j in range(pixel_count):
        i = _u(j)
        count, sa, sb, sw = sums[i], sums[i + _SA], sums[i + _SB], sums[i + _SW]
        caa, cab = sums[i + _SAA] - sa * sa / count, sums[i + _SAB] - sa * sb / count
        cbb = sums[i + _SBB] - sb * sb / count
        caw, cbw = sums[i + _SAW] - sa * sw / count, sums[i + _SBW] - sb * sw / count
        determinant = caa * cbb - cab * cab
        alpha = (caw * cbb - cbw * cab) / determinant
        beta = (cbw * caa - caw * cab) / determinant
        gamma = w0[i] + (sw - alpha * sa - beta * sb) / count - alpha * a0[i] - beta * b0[i]
        # (α, β, γ)·X = 1 > 0 on the plane: it points away from the camera at the origin.
        scale = -1.0 / np.sqrt(alpha * alpha + beta * beta + gamma * gamma)
        # Neighbours lie on a line when the squared correlation of their places is within 0.001 of 1.
        spans = determinant > 1e-3 * caa * cbb
        sums[i] = alpha * scale if spans else 0.0
        sums[i + _SA] = beta * scale if spans else 0.0
        sums[i + _SB] = gamma * scale if spans else 0.0
    for j in range(pixel_count):
        i = _u(j)
        at = index[i]
        if at >= 0:
            normals[at, 0], normals[at, 1], normals[at, 2] = sums[i], sums[i + _SA], sums[i + _SB]
