"""Projector coordinates at a board's points: a quadric fitted to the pixels around each, without outliers."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fpplab.characterisation.limits import LOCAL_FIT_LIMITS as LIMITS
from fpplab.core.cholesky import solve_positive
from fpplab.core.conventions import Floats, Map
from fpplab.targets import Target
from fpplab.targets.views import Detection, window_pixels


def coordinates_at_points(
    maps: Floats, modulation: Map, target: Target, detection: Detection, half_mm: float
) -> Floats:
    """Fit the projector coordinates of the points found, within a square about each."""
    # maps (height, width, 2) px; modulation (height, width); half_mm half the square's side; returns (K, 2)
    frames = target.layout.frames(detection)
    coordinates = np.full((len(frames), 2), np.nan)
    inverses = np.ascontiguousarray(np.linalg.inv(frames))
    reaches = half_mm * np.abs(frames).sum(axis=2).max(axis=1)
    _fit_all(
        maps, modulation, np.ascontiguousarray(detection.pixels), inverses, half_mm, reaches, coordinates
    )
    return coordinates


@njit(parallel=True, cache=True, error_model="numpy")
def _fit_all(
    maps: Floats,
    modulation: Map,
    pixels: Floats,
    inverses: Floats,
    half: float,
    reaches: Floats,
    coordinates: Floats,
) -> None:
    for i in prange(len(pixels)):
        rows, columns = window_pixels(modulation, pixels[i], inverses[i], half)
        basis, observed = np.empty((len(rows), 6)), np.empty((len(rows), 2))
        weight, n = np.empty(len(rows)), 0
        for j in range(len(rows)):
            values, sure = maps[rows[j], columns[j]], float(modulation[rows[j], columns[j]])
            if not (np.isfinite(values[0]) and np.isfinite(values[1]) and sure > 0.0):
                continue
            x, y = (columns[j] - pixels[i, 0]) / reaches[i], (rows[j] - pixels[i, 1]) / reaches[i]
            row = basis[n]
            row[0], row[1], row[2], row[3], row[4], row[5] = 1.0, x, y, x * x, x * y, y * y
            observed[n, 0], observed[n, 1], weight[n], n = values[0], values[1], sure, n + 1
        _value_at_centre(basis[:n], observed[:n], weight[:n], coordinates[i])


@njit(cache=True, error_model="numpy")
def _value_at_centre(basis: Floats, observed: Floats, weight: Floats, centre_value: Floats) -> None:
    """Fit a quadric without outliers; its value at the origin is written, or NaN."""
    used, coefficients = np.ones(len(basis), np.bool_), np.empty((2, 6))
    misfit = np.empty(observed.shape)
    for _ in range(LIMITS.max_rounds):
        middle = np.hypot(basis[used, 1].mean(), basis[used, 2].mean()) if used.any() else np.inf
        if (
            used.sum() < LIMITS.min_pixels
            or middle > LIMITS.max_off_centre
            or not _fit_weighted_quadric(basis, observed, weight, used, coefficients)
        ):
            centre_value[:] = np.nan
            return
        agree = np.ones(len(basis), np.bool_)
        for k in range(2):
            misfit[:, k] = np.abs(observed[:, k] - basis @ coefficients[k]) * weight
            agree &= misfit[:, k] <= LIMITS.max_median_ratio * np.median(misfit[used, k]) + 1e-9
        if np.array_equal(agree, used):
            break
        used = agree
    centre_value[:] = coefficients[:, 0]


@njit(cache=True, error_model="numpy")
def _fit_weighted_quadric(
    basis: Floats, observed: Floats, weight: Floats, used: NDArray[np.bool_], coefficients: Floats
) -> bool:
    """Weighted least squares over the pixels used, into `coefficients` (2, 6); whether they determine it."""
    normal, right = np.zeros((6, 6)), np.zeros((2, 6))
    for j in range(len(basis)):
        if used[j]:
            sure = weight[j] * weight[j]
            for p in range(6):
                for q in range(p + 1):
                    normal[p, q] += sure * basis[j, p] * basis[j, q]
                right[0, p] += sure * basis[j, p] * observed[j, 0]
                right[1, p] += sure * basis[j, p] * observed[j, 1]
    first = solve_positive(normal, right[0], 0.0, coefficients[0])
    return first and solve_positive(normal, right[1], 0.0, coefficients[1])
