"""Detection of a whole board in an image, with points located to a small fraction of a pixel."""

from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fpplab.core.cholesky import solve_positive
from fpplab.core.compiled import kernel, kernel_part
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError
from fpplab.targets.layout import BoardLayout
from fpplab.targets.limits import TARGET_LIMITS as LIMITS
from fpplab.targets.profiles import PointModel, profile
from fpplab.targets.views import Detection, stretch_to_8_bits, window_pixels


def fit_centres(level: Floats, pixels: Floats, jacobians: Floats, model: PointModel) -> Floats:
    # level (height, width); pixels (K, 2); jacobians (K, 2, 2) px; returns (K, 2) px
    if not len(pixels):
        return np.empty((0, 2))
    starts = np.array([model.initial_parameters(jacobian) for jacobian in jacobians])
    inverses, centres = np.ascontiguousarray(np.linalg.inv(jacobians)), np.full((len(pixels), 2), np.nan)
    near = np.ascontiguousarray(pixels)
    _fit_all(level, near, inverses, model.half_mm, int(model.surroundings), starts, centres)
    return centres


@kernel(parallel=True, error_model="numpy")
def _fit_all(
    level: Floats, pixels: Floats, inverses: Floats, half: float, kind: int, starts: Floats, centres: Floats
) -> None:
    for i in prange(len(pixels)):  # the parallel loop calls what is compiled apart, in a fraction of the time
        _fit_centre(level, pixels[i], inverses[i], half, kind, starts[i], centres[i])


@kernel_part(error_model="numpy")
def _fit_centre(
    level: Floats, pixel: Floats, inverse: Floats, half: float, kind: int, start: Floats, centre: Floats
) -> None:
    rows, columns = window_pixels(level, pixel, inverse, half)
    if len(rows) < LIMITS.min_model_pixels:
        return
    values = np.empty(len(rows))
    for j in range(len(rows)):
        values[j] = level[rows[j], columns[j]]
    x, y = columns - pixel[0], rows - pixel[1]
    theta = np.zeros(len(start) + 4)
    for k in range(len(start)):
        theta[k] = start[k]
    converged = _fit(kind, theta, x, y, values)
    shift = inverse @ theta[:2]
    if converged and max(abs(shift[0]), abs(shift[1])) <= 0.5 * half:
        centre[0], centre[1] = pixel[0] + theta[0], pixel[1] + theta[1]


@kernel_part(error_model="numpy")
def _fit(kind: int, theta: Floats, x: Floats, y: Floats, values: Floats) -> bool:
    """Fit θ in place; whether it converged."""
    n = len(theta)
    normal, gradient, step = np.empty((n, n)), np.empty(n), np.zeros(n)
    _equations(kind, theta, x, y, values, normal, gradient)
    if not solve_positive(normal[-4:, -4:].copy(), gradient[-4:].copy(), 0.0, step[-4:]):
        return False
    theta += step
    cost, damping = _equations(kind, theta, x, y, values, normal, gradient), 1e-3
    trial_normal, trial_gradient = np.empty((n, n)), np.empty(n)
    for _ in range(LIMITS.max_fit_steps):
        if not solve_positive(normal, gradient, damping, step):
            return False
        trial = theta + step
        trial_cost = _equations(kind, trial, x, y, values, trial_normal, trial_gradient)
        ended = abs(step[0]) < LIMITS.centre_tolerance_px and abs(step[1]) < LIMITS.centre_tolerance_px
        if trial_cost <= cost:
            ended = ended and cost - trial_cost <= 1e-6 * cost
            for k in range(n):  # assigning a slice to a slice takes seconds more to compile
                theta[k] = trial[k]
            cost, normal, trial_normal = trial_cost, trial_normal, normal
            gradient, trial_gradient = trial_gradient, gradient
            damping = max(0.1 * damping, 1e-12)
        else:
            damping *= 10.0
        if ended:
            return bool(np.isfinite(cost))
    return False


@kernel_part(error_model="numpy")
def _equations(
    kind: int, theta: Floats, x: Floats, y: Floats, values: Floats, normal: Floats, gradient: Floats
) -> float:
    """Compute the normal equations; the sum of squares is returned."""
    n = len(theta)
    m = n - 4
    row, cost = np.empty(n), 0.0
    normal[:], gradient[:] = 0.0, 0.0
    for i in range(len(x)):
        shape, varies = profile(kind, theta[:m], x[i], y[i], row[:m])
        row[m], row[m + 1], row[m + 2], row[m + 3] = 1.0, x[i], y[i], shape
        misfit = values[i] - theta[n - 1] * shape
        misfit -= theta[m] + theta[m + 1] * x[i] + theta[m + 2] * y[i]
        cost += misfit * misfit
        first = m
        if varies:
            first = 0
            for k in range(m):
                row[k] *= theta[n - 1]
        for k in range(first, n):
            gradient[k] += row[k] * misfit
            for q in range(first, k + 1):
                normal[k, q] += row[k] * row[q]
    for k in range(n):
        for q in range(k):
            normal[q, k] = normal[k, q]
    return cost


def detect(layout: BoardLayout, image: NDArray[Any]) -> Detection | None:
    # Of a board that looks the same after half a turn, the order is the one whose x axis points right or down
    # in the image.
    # image (height, width)
    if image.ndim != 2 or min(image.shape) < 16:
        raise CalibrationError(f"a board is detected in a grey image, not in an array {image.shape}")
    level = np.nan_to_num(np.asarray(image, np.float64))
    coarse = layout.find(stretch_to_8_bits(level), level)
    return refine_points(layout, coarse, level) if coarse is not None else None


def refine_points(layout: BoardLayout, coarse: Detection, level: Floats) -> Detection | None:
    # level (height, width)
    centres = fit_centres(level, coarse.pixels, layout.jacobians(coarse), layout.point_model())
    fitted = np.isfinite(centres).all(axis=1)
    if fitted.sum() < LIMITS.min_points:
        return None
    return layout.corrected(Detection(coarse.ids[fitted], centres[fitted]))
