"""Fit of light and sharpness of the twin: Gauss-Newton on image residuals, derivatives by finite differences.

Images determine only the product of lamp, board and lens. The free parameters are chosen so that they are
determined: the level of the board's ground by `white` (or by `paper`, where white is known from a card), then
the reflectance of its print, ambient light, and the camera's black level.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from fpplab.core.conventions import Floats
from fpplab.core.robust import multiway_covariance
from fpplab.patterns.curve import Curve
from sim.matching.loss import level_weights
from sim.matching.reference import Reference
from sim.matching.samples import LightSample, PixelSample
from sim.parameters import TwinParameters
from sim.twin import Twin

MAX_ROUNDS = 3
CONVERGED_GAIN = 5e-3
"""Relative decrease of the cost below which the fit has converged."""
MAX_HALVINGS = 4
LEAST_EIGENVALUE = 1e-9
"""Of the scaled normal equations, relative to the greatest: what is less determined is left as it is."""


@dataclass(frozen=True)
class AdjustableParameter:
    """A scalar parameter of a twin that can be fitted."""

    step: float  # step of the finite difference, in the parameter's unit
    lower: float  # range of values that a world accepts
    upper: float  # range of values that a world accepts
    read: Callable[[TwinParameters], float]  # gives the value from `TwinParameters`
    set: Callable[[TwinParameters, float], TwinParameters]  # gives `TwinParameters` with another value

    def with_value(self, parameters: TwinParameters, value: float) -> TwinParameters:
        """Set the value, clipped to the range."""
        return self.set(parameters, min(max(value, self.lower), self.upper))


def _plain(name: str, step: float, lower: float, upper: float) -> AdjustableParameter:
    def read(parameters: TwinParameters) -> float:
        return float(getattr(parameters, name))

    def set_(parameters: TwinParameters, value: float) -> TwinParameters:
        changes: dict[str, Any] = {name: value}
        return replace(parameters, **changes)

    return AdjustableParameter(step, lower, upper, read, set_)


def _coefficient(index: int) -> AdjustableParameter:
    """One of the projector's falloff."""

    def set_(parameters: TwinParameters, value: float) -> TwinParameters:
        x, y, xx, xy, yy = (
            value if n == index else one for n, one in enumerate(parameters.projector_falloff)
        )
        return replace(parameters, projector_falloff=(x, y, xx, xy, yy))

    return AdjustableParameter(0.02, -2.0, 2.0, lambda p: p.projector_falloff[index], set_)


def _nearness() -> AdjustableParameter:
    """The inverse of the lamp's distance, in 1/m: light changes evenly with it, and far away it is 0."""
    return AdjustableParameter(
        0.05,
        0.01,
        10.0,
        lambda p: 1e3 / p.lamp_distance_mm,
        lambda p, value: replace(p, lamp_distance_mm=1e3 / value),
    )


FALLOFF = tuple(f"falloff_{term}" for term in ("x", "y", "xx", "xy", "yy"))
"""Names of the coefficients of the projector's falloff."""
LAMP = ("lamp_irradiance", "lamp_angle_deg", "lamp_azimuth_deg", "lamp_nearness")
"""Names of the parameters of the room's lamp."""


def normalised_response(curve: Curve, *, black: float | None = None, g: float | None = None) -> Curve:
    """Scale a response so that its white is 1."""
    dark = curve.b / (curve.a + curve.b) if black is None else black
    return Curve(a=1.0 - dark, b=dark, g=curve.g if g is None else g, spline=curve.spline)


ADJUSTABLE = {
    "white": _plain("white", 0.01, 0.01, 100.0),
    "paper": _plain("paper", 0.01, 0.02, 1.0),
    "ink": _plain("ink", 0.005, 0.0, 1.0),
    "ambient": _plain("ambient", 0.005, 0.0, 10.0),
    "black_level": _plain("black_level", 0.002, 0.0, 0.49),
    "projector_blur": _plain("projector_blur", 0.05, 0.35, 20.0),
    "projector_focus_mm": _plain("projector_focus_mm", 2.0, 50.0, 5000.0),
    "projector_aperture_mm": _plain("projector_aperture_mm", 0.5, 0.0, 60.0),
    "camera_focus_mm": _plain("camera_focus_mm", 2.0, 50.0, 5000.0),
    "f_number": _plain("f_number", 0.2, 0.7, 64.0),
    "vignetting": _plain("vignetting", 0.5, 0.0, 40.0),
    **{name: _coefficient(index) for index, name in enumerate(FALLOFF)},
    "lamp_irradiance": _plain("lamp_irradiance", 0.005, 0.0, 10.0),
    "lamp_angle_deg": _plain("lamp_angle_deg", 2.0, -150.0, 150.0),
    "lamp_azimuth_deg": _plain("lamp_azimuth_deg", 2.0, -360.0, 360.0),
    "lamp_nearness": _nearness(),
    "b": AdjustableParameter(
        0.005,
        0.0,
        0.5,
        lambda p: p.response.b,
        lambda p, v: replace(p, response=normalised_response(p.response, black=v)),
    ),
    "g": AdjustableParameter(
        0.01,
        0.2,
        5.0,
        lambda p: p.response.g,
        lambda p, v: replace(p, response=normalised_response(p.response, g=v)),
    ),
}
"""The parameters that can be fitted, by name; `b` and `g` are those of the response."""


def light_residuals(reference: Reference, twin: Twin, samples: Sequence[LightSample]) -> Floats:
    """Compute the residuals of a twin."""
    return np.concatenate([sample.residual(reference, twin) for sample in samples])


def mean_square_difference(reference: Reference, twin: Twin, samples: Sequence[LightSample]) -> float:
    """Compute the mean square of the residuals."""
    return float(np.mean(light_residuals(reference, twin, samples) ** 2))


def information_criterion(
    reference: Reference, twin: Twin, samples: Sequence[PixelSample], free: int
) -> float:
    """Compute Schwarz's criterion (BIC) of a twin; the least is the best.

    Residuals of one tile of an image count as one, for neighbours share what a fit leaves. They have the
    weights of the fit: what the twin lacks at the board's edge says nothing of the light on it.
    """
    count = sum(len(sample.images) * len(np.unique(sample.tiles)) for sample in samples)
    residual = light_residuals(reference, twin, samples)
    left = float(np.mean(level_weights(residual)[0] * residual**2))
    return float(count * np.log(max(left, 1e-12)) + free * np.log(count))


def fit_light(
    reference: Reference, twin: Twin, names: Sequence[str], samples: Sequence[LightSample]
) -> TwinParameters:
    """Fit the named parameters to the images; all others are held.

    Robust Gauss-Newton with at most `MAX_ROUNDS` steps, each halved up to `MAX_HALVINGS` times until it
    lowers the cost.
    """
    residual = light_residuals(reference, twin, samples)
    sigma: dict[str, float] = {}
    for _ in range(MAX_ROUNDS):
        gained, twin, residual, sigma = _round(reference, twin, names, samples, residual)
        if gained < CONVERGED_GAIN:
            break
    best = twin.parameters
    return replace(best, sigma={**best.sigma, **sigma})


def _round(
    reference: Reference,
    twin: Twin,
    names: Sequence[str],
    samples: Sequence[LightSample],
    residual: Floats,
) -> tuple[float, Twin, Floats, dict[str, float]]:
    """Make one step: the relative gain, the twin after it, its residuals and standard uncertainties."""
    start = twin.parameters
    weight, _ = level_weights(residual)
    cost = float(np.sum(weight * residual**2))
    matrix = level_slopes(reference, twin, names, samples, residual)
    scale = np.sqrt(np.sum(weight[:, None] * matrix**2, axis=0))
    scale[scale == 0] = 1.0
    scaled = matrix / scale
    normal, gradient = scaled.T @ (weight[:, None] * scaled), scaled.T @ (weight * residual)
    value = np.array([ADJUSTABLE[name].read(start) for name in names])
    lowest, highest = np.array([(ADJUSTABLE[name].lower, ADJUSTABLE[name].upper) for name in names]).T
    step = _bounded_step(normal, gradient, (lowest - value) * scale, (highest - value) * scale) / scale
    sigma = dict(
        zip(names, (_standard_errors(scaled, weight, residual, samples) / scale).tolist(), strict=True)
    )
    for tried, after in _step_candidates(reference, twin, names, samples, step):
        gain = 1.0 - float(np.sum(weight * after**2)) / max(cost, 1e-12)
        if gain > 0:
            return gain, tried, after, sigma
    return 0.0, twin, residual, sigma


def _bounded_step(normal: Floats, gradient: Floats, lower: Floats, upper: Floats) -> Floats:
    """Solve normal equations (C, C) for the step (C,) of the least cost between bounds.

    A step that is cut at a bound is not the best for the other parameters: they would go along with a
    parameter that does not.
    """
    size, turned = np.linalg.eigh(normal)
    kept = size > LEAST_EIGENVALUE * size[-1]
    root = np.sqrt(size[kept])
    matrix = root[:, None] * turned[:, kept].T
    right_side = turned[:, kept].T @ gradient / root
    # Rounding may have left a value just outside of its bounds.
    bounds = (np.minimum(lower, 0.0), np.maximum(upper, 0.0))
    return np.asarray(lsq_linear(matrix, right_side, bounds, method="bvls").x)


def level_slopes(
    reference: Reference,
    twin: Twin,
    names: Sequence[str],
    samples: Sequence[LightSample],
    residual: Floats,
) -> Floats:
    """Differentiate the twin's levels by parameters, by finite differences."""
    # residual (N,); returns (N, C)
    start, slopes = twin.parameters, []
    for name in names:
        knob = ADJUSTABLE[name]
        value = knob.read(start)
        by = knob.step if value + knob.step <= knob.upper else -knob.step
        there = twin.with_parameters(knob.set(start, value + by))
        slopes.append((residual - light_residuals(reference, there, samples)) / by)
    return np.stack(slopes, axis=1)


def _standard_errors(
    matrix: Floats, weight: Floats, residual: Floats, samples: Sequence[LightSample]
) -> Floats:
    """Standard uncertainties (C,) that allow residuals to be as dependent as they are.

    What remains of a fit is not noise but what the twin lacks. Places of the board share it over all poses,
    poses over all of their places and images, and images of one pattern over all poses. Their parts are
    added, since one of them may make up for another by chance only (`multiway_covariance`).
    """
    clusters = np.concatenate([sample.clusters for sample in samples], axis=1)
    scores = matrix * (weight * residual)[:, None]
    inverse = np.linalg.pinv(matrix.T @ (weight[:, None] * matrix))
    return np.sqrt(np.diag(multiway_covariance(inverse, scores, list(clusters))))


def _step_candidates(
    reference: Reference,
    twin: Twin,
    names: Sequence[str],
    samples: Sequence[LightSample],
    step: Floats,
) -> Iterator[tuple[Twin, Floats]]:
    """Apply the step, and halves of it; yield the twin and its residuals."""
    start = twin.parameters
    for halving in range(MAX_HALVINGS):
        tried = start
        for name, by in zip(names, step.tolist(), strict=True):
            knob = ADJUSTABLE[name]
            tried = knob.with_value(tried, knob.read(start) + by / 2**halving)
        there = twin.with_parameters(tried)
        yield there, light_residuals(reference, there, samples)


def focus_distances(parameters: TwinParameters, focus: str) -> list[float]:
    """Give distances at which a focus may be, by those of the board's poses."""
    depths = np.array([pose.translation[2] for pose in parameters.poses])
    if focus == "projector_focus_mm":
        to_projector = parameters.calibration.T_projector_camera
        depths = np.array([to_projector.apply(pose.translation)[2] for pose in parameters.poses])
    middle, half = float(np.median(depths)), max(float(np.ptp(depths)), 0.05 * float(np.median(depths)))
    return [middle + share * half for share in (-0.4, 0.0, 0.4)]


def search_focus_grid(
    reference: Reference,
    twin: Twin,
    samples: Sequence[LightSample],
    focus: str,
    aperture: str,
    apertures: Sequence[float],
) -> TwinParameters:
    """Search a coarse grid of focus distance and aperture, to find a start for a fit of both."""
    start = twin.parameters
    own = float(getattr(start, aperture))
    grid = [(depth, own * opening) for depth in focus_distances(start, focus) for opening in apertures]
    best, least = start, mean_square_difference(reference, twin, samples)
    for depth, opening in grid:
        changes: dict[str, Any] = {focus: depth, aperture: opening}
        tried = replace(start, **changes)
        found = mean_square_difference(reference, twin.with_parameters(tried), samples)
        if found < least:
            best, least = tried, found
    return best
