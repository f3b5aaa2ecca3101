"""A cloud as a surface over its camera's pixels: connectivity, normals, faces, local fits.

Two points lie on one surface when the step in depth between them is no more than a surface
inclined by `STEEPEST_DEG` to the image plane would show over the footprint that separates
their rays at that depth, plus `NOISE_SIGMAS` standard deviations of the step's own noise.
A longer step is a jump from one surface to another.

Everything is computed in w = 1/z over the ray's slopes (a, b) = (x/z, y/z), where a plane is
linear: α a + β b + γ = w, with (α, β, γ) along its normal. The rule then reads
`|Δw| <= w (tan(STEEPEST) |Δ(a, b)| + NOISE_SIGMAS σ(Δz)/z)`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Map

STEEPEST_DEG = 80.0
"""Greatest inclination of a surface to the image plane."""
NOISE_SIGMAS = 4.0
"""Standard deviations of noise that are allowed in a step within one surface."""
NORMAL_REACH = 2
"""A point's normal is that of the plane through it and its eight neighbours this many px away."""

_STEEPEST = np.float32(np.tan(np.radians(STEEPEST_DEG)))
_LINE = 1e-3
"""Neighbours lie on a line when the squared correlation of their places is within this of 1."""
_TERMS = 6

GridPoints = NDArray[np.float32]
PixelColumnsRows = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class PixelGrid:
    """The points of a cloud arranged over the camera's pixels, all arrays (height, width) indexed [v, u].

    Attributes
    ----------
    index : ndarray of int32
        Number of the point, -1 where there is none.
    a, b : ndarray of float32
        Slopes x/z and y/z of the point's ray, NaN where there is no point.
    w : ndarray of float32
        Inverse depth 1/z in 1/mm, NaN where there is no point.
    noise : ndarray of float32
        The point's contribution, from its noise, to the relative step in depth that is allowed.
    count : int
        Number of points.
    """

    index: PixelColumnsRows
    a: Map
    b: Map
    w: Map
    noise: Map
    count: int

    @classmethod
    def of(
        cls,
        points: GridPoints,
        pixels: PixelColumnsRows,
        size: tuple[int, int],
        sigma_mm: GridPoints | None = None,
    ) -> PixelGrid:
        """Arrange points over the pixels that saw them.

        Parameters
        ----------
        points : ndarray of float32
            (N, 3) in mm in the camera's frame.
        pixels : ndarray of int32
            (N, 2) as (u, v), at most one point per pixel.
        size : tuple of int
            Width and height of the camera in px.
        sigma_mm : ndarray of float32, optional
            Standard deviation (N,) of each point's noise in mm; None means no noise.

        Returns
        -------
        PixelGrid
            The points by pixel.
        """
        shape = size[1], size[0]
        index = np.full(shape, -1, np.int32)
        a, b, w = (np.full(shape, np.nan, np.float32) for _ in range(3))
        noise = np.zeros(shape, np.float32)
        sigma = np.zeros(len(points), np.float32) if sigma_mm is None else sigma_mm
        _scatter(points, pixels, sigma, NOISE_SIGMAS / np.sqrt(2.0), index, a, b, w, noise)
        return cls(index, a, b, w, noise, len(points))

    def normals(self) -> GridPoints:
        """Compute normals from the plane through each point and its neighbours `NORMAL_REACH` px away.

        Returns
        -------
        ndarray of float32
            Unit normals (N, 3) facing the camera, (0, 0, 0) where the neighbours do not span a plane.
        """
        found = np.zeros((self.count, 3), np.float32)
        _normals(self.index, self.a, self.b, self.w, self.noise, found)
        return found

    def faces(self) -> PixelColumnsRows:
        """Triangulate neighbouring pixels, but not across jumps in depth.

        Each square of four pixels is divided along the diagonal with the smaller step in depth; a
        square that lacks a corner still gives the triangle of the other three.

        Returns
        -------
        ndarray of int32
            Numbers (M, 3) of points; front sides face the camera.
        """
        planes = self.index, self.a, self.b, self.w, self.noise
        counts = np.zeros(len(self.index), np.int64)
        _faces(*planes, True, counts, np.empty((0, 3), np.int32))
        found = np.empty((int(counts.sum()), 3), np.int32)
        _faces(*planes, False, np.cumsum(counts) - counts, found)
        return found

    def quadric_distances(self, window: int) -> GridPoints:
        """Compute each point's distance from the quadric fitted to its window.

        The quadric is that of 1/z over the pixels. The point takes part in its own fit.

        Parameters
        ----------
        window : int
            Side of the window in px, odd.

        Returns
        -------
        ndarray of float32
            Signed distances (N,) in mm along the normal, positive towards the camera; NaN where less than
            half of the window is connected with its centre.
        """
        found = np.full(self.count, np.nan, np.float32)
        design = _quadric_design(window)
        inverse = np.ascontiguousarray(np.linalg.pinv(design)[:3])
        planes = self.index, self.a, self.b, self.w, self.noise
        _quadric(*planes, design, inverse, self._slope_per_pixel(), found)
        return found

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


@njit(parallel=True, cache=True, error_model="numpy")
def _scatter(
    points: GridPoints,
    pixels: PixelColumnsRows,
    sigma: GridPoints,
    weight: float,
    index: PixelColumnsRows,
    a: Map,
    b: Map,
    w: Map,
    noise: Map,
) -> None:
    for i in prange(len(points)):
        u, v = pixels[i, 0], pixels[i, 1]
        near = 1.0 / points[i, 2]
        index[v, u] = i
        a[v, u], b[v, u], w[v, u] = points[i, 0] * near, points[i, 1] * near, near
        if sigma[i] > 0.0:
            noise[v, u] = weight * sigma[i] * near


def gather(values: NDArray[Any], rows: NDArray[np.intp]) -> NDArray[Any]:
    """Select rows of an array, on all processors.

    Parameters
    ----------
    values : ndarray, (N,) or (N, C)
        Any numbers.
    rows : ndarray of intp, (M,)
        Which.

    Returns
    -------
    ndarray
        (M,) or (M, C), of the same type.
    """
    found = np.empty((len(rows), *values.shape[1:]), values.dtype)
    _gather(values.reshape(len(values), -1), rows, found.reshape(len(found), -1))
    return found


@njit(parallel=True, cache=True)
def _gather(values: NDArray[Any], rows: NDArray[np.intp], found: NDArray[Any]) -> None:
    for i in prange(len(rows)):
        for k in range(values.shape[1]):
            found[i, k] = values[rows[i], k]


def at_pixels(values: NDArray[Any], pixels: PixelColumnsRows) -> NDArray[Any]:
    """Select the pixels of a map, on all processors.

    Parameters
    ----------
    values : ndarray, (height, width)
        Any numbers.
    pixels : ndarray of int32, (N, 2)
        Columns and rows, all in the map.

    Returns
    -------
    ndarray
        (N,), of the same type.
    """
    found = np.empty(len(pixels), values.dtype)
    _at_pixels(values, pixels, found)
    return found


@njit(parallel=True, cache=True)
def _at_pixels(values: NDArray[Any], pixels: PixelColumnsRows, found: NDArray[Any]) -> None:
    for i in prange(len(pixels)):
        found[i] = values[pixels[i, 1], pixels[i, 0]]


@njit(cache=True)
def are_within(pixels: PixelColumnsRows, width: int, height: int) -> bool:
    """Tell whether all pixels lie in an image.

    Parameters
    ----------
    pixels : ndarray of int32, (N, 2)
        Columns and rows.
    width, height : int
        Of the image in px.

    Returns
    -------
    bool
        True where none lies outside.
    """
    inside = True
    for i in range(len(pixels)):
        u, v = pixels[i, 0], pixels[i, 1]
        inside &= (u >= 0) & (u < width) & (v >= 0) & (v < height)
    return inside


@njit(inline="always")
def is_continuous(da: float, db: float, dw: float, w: float, noise: float) -> bool:
    """Decide whether two points lie on one surface, by the rule of this module.

    Parameters
    ----------
    da, db : float
        Differences of the rays' slopes.
    dw : float
        Difference of the inverse depths in 1/mm.
    w : float
        Inverse depth of the step in 1/mm.
    noise : float
        Sum of the two points' `PixelGrid.noise`.

    Returns
    -------
    bool
        True on one surface; False across a jump, or where a difference is NaN.
    """
    return bool(abs(dw) <= w * (_STEEPEST * np.sqrt(da * da + db * db) + noise))


@njit(parallel=True, cache=True, error_model="numpy")
def _normals(index: PixelColumnsRows, a: Map, b: Map, w: Map, noise: Map, found: GridPoints) -> None:
    height, width = index.shape
    for v in prange(height):
        for u in range(width):
            i = index[v, u]
            if i < 0:
                continue
            a0, b0, w0, noise0 = a[v, u], b[v, u], w[v, u], noise[v, u]
            n = sa = sb = sw = saa = sab = sbb = saw = sbw = 0.0
            for y in range(v - NORMAL_REACH, v + NORMAL_REACH + 1, NORMAL_REACH):
                for x in range(u - NORMAL_REACH, u + NORMAL_REACH + 1, NORMAL_REACH):
                    if y < 0 or x < 0 or y >= height or x >= width:
                        continue
                    da, db, dw = a[y, x] - a0, b[y, x] - b0, w[y, x] - w0
                    # False where there is no point.
                    if is_continuous(da, db, dw, w0, noise0 + noise[y, x]):
                        n += 1.0
                        sa, sb, sw = sa + da, sb + db, sw + dw
                        saa, sab, sbb = saa + da * da, sab + da * db, sbb + db * db
                        saw, sbw = saw + da * dw, sbw + db * dw
            caa, cab, cbb = saa - sa * sa / n, sab - sa * sb / n, sbb - sb * sb / n
            caw, cbw = saw - sa * sw / n, sbw - sb * sw / n
            determinant = caa * cbb - cab * cab
            if determinant <= _LINE * caa * cbb:
                continue
            alpha = (caw * cbb - cbw * cab) / determinant
            beta = (cbw * caa - caw * cab) / determinant
            gamma = w0 + (sw - alpha * sa - beta * sb) / n - alpha * a0 - beta * b0
            # (α, β, γ)·X = 1 > 0 on the plane: it points away from the camera at the origin.
            scale = -1.0 / np.sqrt(alpha * alpha + beta * beta + gamma * gamma)
            found[i, 0], found[i, 1], found[i, 2] = alpha * scale, beta * scale, gamma * scale


@njit(parallel=True, cache=True, error_model="numpy")
def _faces(
    index: PixelColumnsRows,
    a: Map,
    b: Map,
    w: Map,
    noise: Map,
    counting: bool,
    starts: NDArray[np.int64],
    found: PixelColumnsRows,
) -> None:
    """Count the faces of each row into `starts`, or fill `found` from there."""
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
                whole = True
                for e in range(3):
                    p, q = triangle[e], triangle[(e + 1) % 3]
                    y0, x0, y1, x1 = v + p // 2, u + p % 2, v + q // 2, u + q % 2
                    whole &= is_continuous(
                        a[y1, x1] - a[y0, x0],
                        b[y1, x1] - b[y0, x0],
                        w[y1, x1] - w[y0, x0],
                        min(w[y0, x0], w[y1, x1]),
                        noise[y0, x0] + noise[y1, x1],
                    )
                if whole:
                    if not counting:
                        for e in range(3):
                            found[at, e] = index[v + triangle[e] // 2, u + triangle[e] % 2]
                    at += 1
        if counting:
            starts[v] = at


@njit(parallel=True, cache=True, error_model="numpy")
def _quadric(
    index: PixelColumnsRows,
    a: Map,
    b: Map,
    w: Map,
    noise: Map,
    design: Floats,
    inverse: Floats,
    slope_per_pixel: tuple[float, float],
    found: GridPoints,
) -> None:
    """Fill the distances from a quadric fitted to each window."""
    height, width = index.shape
    count = len(design)
    side = int(np.sqrt(count) + 0.5)
    radius = side // 2
    for v in prange(height):
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
            found[i] = away / np.sqrt(alpha * alpha + beta * beta + gamma * gamma)


@njit(cache=True, error_model="numpy")
def _fit_present(design: Floats, values: Floats) -> Floats:
    """Fit by least squares to the values that are not NaN."""
    matrix, right = np.zeros((_TERMS, _TERMS)), np.zeros(_TERMS)
    for k in range(len(values)):
        if np.isnan(values[k]):
            continue
        for p in range(_TERMS):
            right[p] += design[k, p] * values[k]
            for q in range(_TERMS):
                matrix[p, q] += design[k, p] * design[k, q]
    return np.linalg.solve(matrix, right)
