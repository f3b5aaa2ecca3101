"""Brightness models of what surrounds a point of a board: two crossing edges, or a disc.

A model has parameters θ of which θ[:2] is the offset of its centre in px; away from its edges it is ±1.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numba import njit

from fpplab.core.compiled import kernel, kernel_part
from fpplab.core.conventions import Floats
from fpplab.targets.limits import TARGET_LIMITS as LIMITS

PER_SQRT_PI = 2.0 / math.sqrt(math.pi)


class Surroundings(IntEnum):
    """What surrounds a point."""

    EDGES = 0
    DISC = 1


_DISC = int(Surroundings.DISC)


@dataclass(frozen=True)
class PointModel:
    """Brightness model of a point and where to fit it."""

    surroundings: Surroundings  # which of the models
    initial_parameters: Callable[[Floats], Floats]  # θ from the Jacobian (2, 2) in px per mm at the point
    half_mm: float  # half the side in mm of the square around the point that shows nothing else

    def brightness(self, theta: Floats, x: Floats, y: Floats) -> Floats:
        # x (n,) px; y (n,) px; returns (n,)
        values = np.empty(len(x))
        _brightness(int(self.surroundings), theta, x, y, values)
        return values


def crossing_edges(half_mm: float) -> PointModel:
    return PointModel(Surroundings.EDGES, _initial_edge_parameters, half_mm)


def disc(radius_mm: float, half_mm: float) -> PointModel:
    # returns (a, b, c) px
    return PointModel(
        Surroundings.DISC, lambda jacobian: _initial_disc_parameters(jacobian, radius_mm), half_mm
    )


def _initial_edge_parameters(jacobian: Floats) -> Floats:
    along_x, along_y = np.arctan2(jacobian[1], jacobian[0])
    return np.array([0.0, 0.0, along_x, along_y, 1.0])


def _initial_disc_parameters(jacobian: Floats, radius_mm: float) -> Floats:
    inverse = np.linalg.inv(jacobian) / radius_mm
    form = inverse.T @ inverse
    return np.array([0.0, 0.0, form[0, 0], form[0, 1], form[1, 1], 1.0])


@kernel(error_model="numpy")
def _brightness(kind: int, theta: Floats, x: Floats, y: Floats, values: Floats) -> None:
    slopes = np.empty(len(theta))
    for i in range(len(x)):
        values[i], _ = profile(kind, theta, x[i], y[i], slopes)


@kernel_part(error_model="numpy")
def profile(kind: int, theta: Floats, x: float, y: float, slopes: Floats) -> tuple[float, bool]:
    """Compute a model's brightness at one pixel, with derivatives. Compiled."""
    # theta (5,)
    if kind == _DISC:
        return _disc(theta, x - theta[0], y - theta[1], slopes)
    return _edges(theta, x - theta[0], y - theta[1], slopes)


@kernel_part(error_model="numpy")
def _edges(theta: Floats, u: float, v: float, slopes: Floats) -> tuple[float, bool]:
    blur = theta[4]
    cosines, sines = (math.cos(theta[2]), math.cos(theta[3])), (math.sin(theta[2]), math.sin(theta[3]))
    distances = (cosines[0] * v - sines[0] * u) / blur, (cosines[1] * v - sines[1] * u) / blur
    values = _blurred(distances[0]), _blurred(distances[1])
    varies = min(abs(distances[0]), abs(distances[1])) <= LIMITS.edge_blurs
    if varies:
        slopes[:] = 0.0
        for k in range(2):
            steep = values[1 - k] * PER_SQRT_PI * math.exp(-distances[k] * distances[k]) / blur
            slopes[0] += steep * sines[k]
            slopes[1] -= steep * cosines[k]
            slopes[2 + k] = -steep * (sines[k] * v + cosines[k] * u)
            slopes[4] -= steep * distances[k]
    return values[0] * values[1], varies


@kernel_part(error_model="numpy")
def _disc(theta: Floats, u: float, v: float, slopes: Floats) -> tuple[float, bool]:
    a, b, c, blur = theta[2], theta[3], theta[4], theta[5]
    along_u, along_v = a * u + b * v, b * u + c * v
    square = max(u * along_u + v * along_v, 1e-12)
    radius, gradient = math.sqrt(square), max(math.hypot(along_u, along_v), 1e-12)
    # First-order distance from the rim; only pixels near the rim carry information.
    distance = (square - radius) / gradient
    if abs(distance) > LIMITS.edge_blurs * abs(blur):
        return math.copysign(1.0, distance / blur), False
    steep = PER_SQRT_PI * math.exp(-((distance / blur) ** 2)) / blur
    # By u, v, a, b, c: of the radius's square, and of half the gradient's square.
    by_square = 1.0 - 0.5 / radius
    squares = 2 * along_u, 2 * along_v, u * u, 2 * u * v, v * v
    gradients = (
        along_u * a + along_v * b,
        along_u * b + along_v * c,
        along_u * u,
        along_u * v + along_v * u,
        along_v * v,
    )
    for k in range(5):
        slope = (by_square * squares[k] - distance * gradients[k] / gradient) / gradient
        slopes[k] = steep * slope * (-1.0 if k < 2 else 1.0)
    slopes[5] = -steep * distance / blur
    return math.erf(distance / blur), True


@njit(inline="always")
def _blurred(distance: float) -> float:
    if abs(distance) > LIMITS.edge_blurs:
        return math.copysign(1.0, distance)
    return math.erf(distance)
