"""A cloud as a surface over its camera's pixels: connectivity, normals, faces, local fits.

Computed in w = 1/z over the ray's slopes (a, b) = (x/z, y/z), where a plane is linear: α a + β b + γ = w.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fpplab.clouds.surfaces import NOISE_SIGMAS, is_continuous, surface_normals
from fpplab.core import buffers
from fpplab.core.cholesky import solve_positive
from fpplab.core.compiled import kernel, kernel_part
from fpplab.core.conventions import Floats, Map

_TERMS = 6  # coefficients of a polynomial of second degree in two variables

GridPoints = NDArray[np.float32]
PixelColumnsRows = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class PixelGrid:
    """The points of a cloud arranged over the camera's pixels, all arrays (height, width) indexed [v, u]."""

    index: PixelColumnsRows  # number of the point, -1 where there is none
    a: Map  # slopes x/z and y/z of the point's ray, NaN where there is no point
    b: Map  # slopes x/z and y/z of the point's ray, NaN where there is no point
    w: Map  # inverse depth 1/z in 1/mm, NaN where there is no point
    noise: Map  # the point's contribution, from its noise, to the relative step in depth that is allowed
    count: int  # number of points

    @classmethod
    def of(
        cls, points: GridPoints, pixels: PixelColumnsRows, size: tuple[int, int], *sigmas_mm: GridPoints
    ) -> PixelGrid:
        # points (N, 3) mm; pixels (N, 2); *sigmas_mm (N,) mm
        shape = size[1], size[0]
        index = buffers.empty(shape, np.int32)
        a, b, w, noise = (buffers.empty(shape) for _ in range(4))
        _clear(index, a, b, w, noise)
        none = np.empty(0, np.float32)
        first_sigma, second_sigma = (*sigmas_mm, none, none)[:2]
        _scatter(
            points=points,
            pixels=pixels,
            sigma=first_sigma,
            other_sigma=second_sigma,
            weight=NOISE_SIGMAS / np.sqrt(2.0),
            index=index,
            a=a,
            b=b,
            w=w,
            noise=noise,
        )
        return cls(index, a, b, w, noise, len(points))

    def normals(self) -> GridPoints:
        """Compute normals from the plane through each point and its neighbours."""
        # returns (N, 3)
        vectors = buffers.empty((self.count, 3))
        surface_normals(self.index, self.a, self.b, self.w, self.noise, vectors)
        return vectors

    def faces(self) -> PixelColumnsRows:
        """Triangulate neighbouring pixels, but not across jumps in depth."""
        # Each square of four pixels is divided along the diagonal with the smaller step in depth; a square
        # that lacks a corner still gives the triangle of the other three.
        # returns (M, 3)
        planes = self.index, self.a, self.b, self.w, self.noise
        counts = np.zeros(len(self.index), np.int64)
        _faces(*planes, True, counts, np.empty((0, 3), np.int32))
        triangles = np.empty((int(counts.sum()), 3), np.int32)
        _faces(*planes, False, np.cumsum(counts) - counts, triangles)
        return triangles

    def quadric_distances(self, window: int, step: int = 1) -> GridPoints:
        """Compute each point's distance from the quadric fitted to its window, in every step-th row."""
        # The quadric is that of 1/z over the pixels. The point takes part in its own fit. NaN elsewhere.
        # returns (N,) mm
        distances = np.full(self.count, np.nan, np.float32)
        design = _quadric_design(window)
        inverse = np.ascontiguousarray(np.linalg.pinv(design)[:3])
        planes = self.index, self.a, self.b, self.w, self.noise
        _quadric(*planes, design, inverse, self._slope_per_pixel(), step, distances)
        return distances

    def _slope_per_pixel(self) -> tuple[float, float]:
        """Compute the mean change of (a, b) from pixel to pixel; distortion changes it little."""
        across, down = np.diff(self.a, axis=1), np.diff(self.b, axis=0)
        across, down = across[np.isfinite(across)], down[np.isfinite(down)]
        if not (across.size and down.size):
            return float("nan"), float("nan")
        return float(across.mean()), float(down.mean())


def _quadric_design(window: int) -> Floats:
    """Compute the columns 1, x, y, x², xy, y², (window², 6), of a window with x, y in [-1, 1]."""
    y, x = (np.mgrid[0:window, 0:window].reshape(2, -1) - window // 2) / (window // 2)
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


@kernel(parallel=True)
def _clear(index: PixelColumnsRows, a: Map, b: Map, w: Map, noise: Map) -> None:
    for v in prange(len(index)):
        index[v, :] = -1
        a[v, :] = b[v, :] = w[v, :] = np.nan
        noise[v, :] = 0.0


@kernel(parallel=True, error_model="numpy")
def _scatter(
    points: GridPoints,
    pixels: PixelColumnsRows,
    sigma: GridPoints,
    other_sigma: GridPoints,
    weight: float,
    index: PixelColumnsRows,
    a: Map,
    b: Map,
    w: Map,
    noise: Map,
) -> None:
    for i in prange(len(points)):
        u, v = pixels[i, 0], pixels[i, 1]
        inverse_depth = 1.0 / points[i, 2]
        index[v, u] = i
        a[v, u], b[v, u], w[v, u] = points[i, 0] * inverse_depth, points[i, 1] * inverse_depth, inverse_depth
        spread = sigma[i] if len(sigma) > 0 else np.float32(0.0)
        if len(other_sigma) > 0:
            spread = np.sqrt(spread * spread + other_sigma[i] * other_sigma[i])
        if spread > 0.0:
            noise[v, u] = weight * spread * inverse_depth


@kernel(parallel=True)
def are_within(pixels: PixelColumnsRows, width: int, height: int) -> bool:
    # pixels (N, 2)
    outside = 0
    for i in prange(len(pixels)):
        u, v = pixels[i, 0], pixels[i, 1]
        outside += not ((u >= 0) & (u < width) & (v >= 0) & (v < height))
    return outside == 0


@kernel(parallel=True, error_model="numpy")
def _faces(
    index: PixelColumnsRows,
    a: Map,
    b: Map,
    w: Map,
    noise: Map,
    counting: bool,
    starts: NDArray[np.int64],
    faces: PixelColumnsRows,
) -> None:
    """Count the faces of each row into `starts`, or fill `faces` from there."""
    height, width = index.shape
    for v in prange(height - 1):
        at = 0 if counting else starts[v]
        for u in range(width - 1):
            # Corners 0 1 over 2 3; they turn 0 2 3 1 as the camera sees them, x right and y down.
            present = 0
            for k in range(4):
                present += index[v + k // 2, u + k % 2] >= 0
            if present < 3:
                continue
            rising = abs(w[v, u + 1] - w[v + 1, u]) < abs(w[v, u] - w[v + 1, u + 1])
            if index[v, u] < 0 or index[v + 1, u + 1] < 0 or rising:
                triangles = ((0, 2, 1), (1, 2, 3))
            else:
                triangles = ((0, 2, 3), (0, 3, 1))
            for triangle in triangles:
                connected = True
                for e in range(3):
                    p, q = triangle[e], triangle[(e + 1) % 3]
                    y0, x0, y1, x1 = v + p // 2, u + p % 2, v + q // 2, u + q % 2
                    connected &= is_continuous(
                        a[y1, x1] - a[y0, x0],
                        b[y1, x1] - b[y0, x0],
                        w[y1, x1] - w[y0, x0],
                        min(w[y0, x0], w[y1, x1]),
                        noise[y0, x0] + noise[y1, x1],
                    )
                if connected:
                    if not counting:
                        for e in range(3):
                            faces[at, e] = index[v + triangle[e] // 2, u + triangle[e] % 2]
                    at += 1
        if counting:
            starts[v] = at


@kernel(parallel=True, error_model="numpy")
def _quadric(
    index: PixelColumnsRows,
    a: Map,
    b: Map,
    w: Map,
    noise: Map,
    design: Floats,
    inverse: Floats,
    slope_per_pixel: tuple[float, float],
    step: int,
    distances: GridPoints,
) -> None:
    height, width = index.shape
    count = len(design)
    side = int(np.sqrt(count) + 0.5)
    radius = side // 2
    for row in prange((height + step - 1) // step):
        v = row * step
        values = np.empty(count)
        for u in range(width):
            i = index[v, u]
            if i < 0:
                continue
            n = 0
            for k in range(count):
                y, x = v + k // side - radius, u + k % side - radius
                values[k] = np.nan
                if 0 <= y < height and 0 <= x < width:
                    da, db, dw = a[y, x] - a[v, u], b[y, x] - b[v, u], w[y, x] - w[v, u]
                    if is_continuous(da, db, dw, w[v, u], noise[v, u] + noise[y, x]):
                        values[k] = w[y, x]
                        n += 1
            if 2 * n < count:
                continue
            fit = inverse @ values if n == count else _fit_present(design, values)
            alpha = fit[1] / (radius * slope_per_pixel[0])
            beta = fit[2] / (radius * slope_per_pixel[1])
            gamma = fit[0] - alpha * a[v, u] - beta * b[v, u]
            # 1/fit - z along the ray's z, of which the normal's share is fit/|(α, β, γ)|.
            away = 1.0 - fit[0] / w[v, u]
            distances[i] = away / np.sqrt(alpha * alpha + beta * beta + gamma * gamma)


@kernel_part(error_model="numpy")
def _fit_present(design: Floats, values: Floats) -> Floats:
    matrix, right = np.zeros((_TERMS, _TERMS)), np.zeros(_TERMS)
    for k in range(len(values)):
        if np.isnan(values[k]):
            continue
        for p in range(_TERMS):
            right[p] += design[k, p] * values[k]
            for q in range(_TERMS):
                matrix[p, q] += design[k, p] * design[k, q]
    solution = np.full(_TERMS, np.nan)  # where the pixels do not determine the surface
    solve_positive(matrix, right, 0.0, solution)
    return solution
