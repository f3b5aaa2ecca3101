"""Fit of light and sharpness of the twin: Gauss-Newton on image residuals, derivatives by finite differences.

Images determine only the product of lamp, board and lens. The free parameters are chosen so that they are
determined: the level of the board's ground by `white` (or by `paper`, where white is known from a card), then
the reflectance of its print, ambient light, and the camera's black level.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from fpplab.core.conventions import Floats
from fpplab.core.robust import multiway_covariance
from sim.matching.loss import level_weights
from sim.matching.reference import Reference
from sim.matching.samples import LightSample, PixelSample
from sim.parameters import ADJUSTABLE, TwinParameters
from sim.twin import Twin


@dataclass(frozen=True)
class LightFitLimits:
    """When a fit of light ends."""

    max_rounds: int = 3  # Gauss-Newton steps (chosen, for speed)
    min_gain: float = 5e-3  # relative decrease of the cost (chosen)
    max_halvings: int = 4  # of a step that does not lower the cost (chosen)
    min_eigenvalue: float = 1e-9  # of the normal equations, relative to the greatest (numerical)


LIMITS = LightFitLimits()

TwinResiduals = Callable[[Twin], Floats]
"""Gives bench less twin at all samples, (N,)."""


def light_residuals(reference: Reference, twin: Twin, samples: Sequence[LightSample]) -> Floats:
    return np.concatenate([sample.residual(reference, twin) for sample in samples])


def mean_square_difference(reference: Reference, twin: Twin, samples: Sequence[LightSample]) -> float:
    return float(np.mean(light_residuals(reference, twin, samples) ** 2))


def information_criterion(
    reference: Reference, twin: Twin, samples: Sequence[PixelSample], free: int
) -> float:
    """Compute Schwarz's criterion (BIC) of a twin; the lowest is the best."""
    # Residuals of one tile of an image count as one, for neighbours share what a fit leaves. They have the
    # weights of the fit: what the twin lacks at the board's edge says nothing of the light on it.
    count = sum(len(sample.images) * len(np.unique(sample.tiles)) for sample in samples)
    residual = light_residuals(reference, twin, samples)
    mean_square = float(np.mean(level_weights(residual)[0] * residual**2))
    return float(count * np.log(max(mean_square, 1e-12)) + free * np.log(count))


def fit_light(
    reference: Reference,
    twin: Twin,
    names: Sequence[str],
    samples: Sequence[LightSample],
    also: Floats | None = None,
) -> TwinParameters:
    """Fit the named parameters to the images; all others are held."""

    # also (N,): what one parameter more would add to the levels, which the twin does not have; it is fitted
    # with the others, so that they do not make up for it, and dropped.
    # Robust Gauss-Newton with at most `max_rounds` steps, each halved up to `max_halvings` times until it
    # lowers the cost.
    def without(whole: Floats) -> Floats:
        return whole if also is None else whole - also * (dual @ whole)

    def residuals(of: Twin) -> Floats:
        return without(light_residuals(reference, of, samples))

    residual = light_residuals(reference, twin, samples)
    if also is not None:
        weighted = level_weights(residual)[0] * also
        dual = weighted / max(float(weighted @ also), 1e-12)
        residual = without(residual)
    sigma: dict[str, float] = {}
    for _ in range(LIMITS.max_rounds):
        gained, twin, residual, sigma = _fit_one_step(residuals, twin, names, samples, residual)
        if gained < LIMITS.min_gain:
            break
    best = twin.parameters
    return replace(best, sigma={**best.sigma, **sigma})


def softness(reference: Reference, twin: Twin, samples: Sequence[PixelSample]) -> Floats:
    """Differentiate levels (N,) by a slight blur that is the same in all poses, as of a print's edges."""
    return np.concatenate([sample.laplacian(reference, twin) for sample in samples])


def _fit_one_step(
    residuals: TwinResiduals,
    twin: Twin,
    names: Sequence[str],
    samples: Sequence[LightSample],
    residual: Floats,
) -> tuple[float, Twin, Floats, dict[str, float]]:
    """Make one step: the relative gain, the twin after it, its residuals and standard uncertainties."""
    start = twin.parameters
    weight, _ = level_weights(residual)
    cost = float(np.sum(weight * residual**2))
    matrix = level_slopes(residuals, twin, names, residual)
    scale = np.sqrt(np.sum(weight[:, None] * matrix**2, axis=0))
    scale[scale == 0] = 1.0
    scaled = matrix / scale
    normal, gradient = scaled.T @ (weight[:, None] * scaled), scaled.T @ (weight * residual)
    value = np.array([ADJUSTABLE[name].read(start) for name in names])
    lowest, highest = np.array([(ADJUSTABLE[name].fit.lower, ADJUSTABLE[name].fit.upper) for name in names]).T
    step = _bounded_step(normal, gradient, (lowest - value) * scale, (highest - value) * scale) / scale
    sigma = dict(
        zip(names, (_standard_errors(scaled, weight, residual, samples) / scale).tolist(), strict=True)
    )
    for tried in _step_candidates(twin, names, step):
        after = residuals(tried)
        gain = 1.0 - float(np.sum(weight * after**2)) / max(cost, 1e-12)
        if gain > 0:
            return gain, tried, after, sigma
    return 0.0, twin, residual, sigma


def _bounded_step(normal: Floats, gradient: Floats, lower: Floats, upper: Floats) -> Floats:
    """Solve normal equations (C, C) for the step (C,) of the lowest cost between bounds."""
    # A step that is cut at a bound is not the best for the other parameters: they would go along with a
    # parameter that does not.
    size, turned = np.linalg.eigh(normal)
    kept = size > LIMITS.min_eigenvalue * size[-1]
    root = np.sqrt(size[kept])
    matrix = root[:, None] * turned[:, kept].T
    right_side = turned[:, kept].T @ gradient / root
    # Rounding may have left a value just outside of its bounds.
    bounds = (np.minimum(lower, 0.0), np.maximum(upper, 0.0))
    return np.asarray(lsq_linear(matrix, right_side, bounds, method="bvls").x)


def level_slopes(residuals: TwinResiduals, twin: Twin, names: Sequence[str], residual: Floats) -> Floats:
    """Differentiate the twin's levels by parameters, by finite differences."""
    # residual (N,); returns (N, C)
    start, slopes = twin.parameters, []
    for name in names:
        knob = ADJUSTABLE[name]
        value = knob.read(start)
        by = knob.fit.step if value + knob.fit.step <= knob.fit.upper else -knob.fit.step
        moved = twin.with_parameters(knob.set(start, value + by))
        slopes.append((residual - residuals(moved)) / by)
    return np.stack(slopes, axis=1)


def _standard_errors(
    matrix: Floats, weight: Floats, residual: Floats, samples: Sequence[LightSample]
) -> Floats:
    """Standard uncertainties (C,) that allow residuals to be as dependent as they are."""
    # What remains of a fit is not noise but what the twin lacks. Places of the board share it over all poses,
    # poses over all of their places and images, and images of one pattern over all poses. Their parts are
    # added, since one of them may make up for another by chance only (`multiway_covariance`).
    clusters = np.concatenate([sample.clusters for sample in samples], axis=1)
    scores = matrix * (weight * residual)[:, None]
    inverse = np.linalg.pinv(matrix.T @ (weight[:, None] * matrix))
    return np.sqrt(np.diag(multiway_covariance(inverse, scores, list(clusters))))


def _step_candidates(twin: Twin, names: Sequence[str], step: Floats) -> Iterator[Twin]:
    """Apply the step, and halves of it."""
    for halving in range(LIMITS.max_halvings):
        tried = twin.parameters
        for name, by in zip(names, step.tolist(), strict=True):
            knob = ADJUSTABLE[name]
            tried = knob.with_value(tried, knob.read(twin.parameters) + by / 2**halving)
        yield twin.with_parameters(tried)
