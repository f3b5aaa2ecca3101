"""Fit of a monotone spline to the levels of a response, and the evidence that decides whether it is needed.

The coefficients of a B-spline that never fall make a curve that never falls (Ramsay's I-splines), and their
rises are found by non-negative least squares. How many there are, and whether the spline replaces the power
law, is decided by how well each level is predicted from the others.

Source: Ramsay, Monotone regression splines in action, Stat. Sci. 3, 1988.
"""

from dataclasses import dataclass

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.patterns.curve import DEGREE, knots
from fpplab.patterns.limits import PATTERN_LIMITS as LIMITS


@dataclass(frozen=True, eq=False)
class SplineFit:
    """A monotone spline through levels."""

    a: float  # rise from dark to white, and level of a dark image
    b: float  # rise from dark to white, and level of a dark image
    coefficients: tuple[float, ...]  # as in `Curve.spline`
    residual: Floats  # levels seen minus fitted
    left_out: Floats  # errors of the prediction of each level from the others
    sigma: tuple[float, float]  # standard uncertainties of a and b
    freedom: int  # degrees of freedom of the residuals


def fit_spline(shown: Floats, recorded: Floats, sigma: Floats | None) -> SplineFit | None:
    """Fit the monotone spline that predicts left-out levels best."""
    # shown, recorded (L,); sigma (L,)
    if shown.min() > 1.0 - LIMITS.min_reach or shown.max() < LIMITS.min_reach:
        return None
    max_count = min(LIMITS.max_coefficients, len(np.unique(shown)) - 2)
    # No level counts much more than the usual one: what the spline lacks is not known to a millionth.
    weight = np.ones_like(recorded) if sigma is None else 1.0 / np.hypot(sigma, np.median(sigma))
    counts = range(DEGREE + 1, max_count + 1)
    fits = [fit for count in counts if (fit := _fit(shown, recorded, weight, count)) is not None]
    return min(fits, key=lambda fit: float(np.mean(fit.left_out[1:-1] ** 2)), default=None)


def _fit(shown: Floats, recorded: Floats, weight: Floats, count: int) -> SplineFit | None:
    from scipy.interpolate import BSpline  # which those do not need who only use a response
    from scipy.optimize import nnls

    basis = BSpline.design_matrix(shown, knots(count), DEGREE).toarray()
    # By the dark level, and the rises from coefficient to coefficient: sums of the basis from each on.
    rises = np.cumsum(basis[:, ::-1], axis=1)[:, ::-1] * weight[:, None]
    solution, _ = nnls(rises, recorded * weight)
    a = float(solution[1:].sum())
    used = solution > 0
    used[0] = True
    freedom = len(shown) - int(used.sum())
    if a <= 0 or freedom < 1:
        return None
    inverse = np.linalg.pinv(rises[:, used].T @ rises[:, used])
    leverage = np.einsum("li,ij,lj->l", rises[:, used], inverse, rises[:, used])
    residual = recorded - rises @ solution / weight
    scale = float(np.sum((weight * residual) ** 2)) / freedom
    rising = used[used.nonzero()[0]].astype(np.float64)
    rising[0] = 0.0
    sigma_a = float(np.sqrt(scale * max(rising @ inverse @ rising, 0.0)))
    sigma_b = float(np.sqrt(scale * max(inverse[0, 0], 0.0)))
    coefficients = np.concatenate([[0.0], np.cumsum(solution[1:]) / a])
    coefficients[-1] = 1.0
    return SplineFit(
        a,
        float(solution[0]),
        tuple(np.minimum(coefficients, 1.0).tolist()),
        residual,
        leave_one_out(residual, leverage),
        (sigma_a, sigma_b),
        freedom,
    )


def leave_one_out(residual: Floats, leverage: Floats) -> Floats:
    """Compute by how much each level would be missed by a fit to the others."""
    # residual (L,); leverage (L,); returns (L,)
    return np.asarray(residual / np.maximum(1.0 - leverage, 1e-3))


def prefers_spline(power: Floats, spline: Floats, sigma: Floats | None) -> bool:
    """Decide between power law and spline."""
    # The levels at both ends, which a spline predicts by extrapolation alone, do not count.
    # power, spline (L,); sigma (L,)
    floor = 0.0 if sigma is None else float(np.mean(sigma[1:-1] ** 2))
    gain = power[1:-1] ** 2 - spline[1:-1] ** 2
    of_power, of_spline = (float(np.mean(errors[1:-1] ** 2)) for errors in (power, spline))
    certain = float(gain.mean()) > LIMITS.coverage * float(gain.std(ddof=1)) / np.sqrt(len(gain))
    return certain and of_power > 2.0 * floor and of_spline < LIMITS.max_error_ratio * of_power
