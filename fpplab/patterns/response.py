"""Response (gamma) of projector and camera together: from the level shown to the level seen.

`I_out = a I_in^g + b`, levels as shares of full scale: a is the gain, b the level seen of a dark image, g
the exponent (gamma); where no power law predicts the levels, a monotone spline takes the place of `I_in^g`.
What a camera sees of `I_in` determines a and b only up to its own gain and black level. The shape between
them does not depend on these, and only the shape distorts fringes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from fpplab.core import config
from fpplab.core.config import Document, Positive
from fpplab.core.conventions import Floats, Mask
from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.core.files import write_text
from fpplab.patterns.curve import Curve, power_law
from fpplab.patterns.limits import PATTERN_LIMITS as LIMITS
from fpplab.patterns.response_spline import SplineFit, fit_spline, leave_one_out, prefers_spline

_Sigma = Annotated[float, Field(ge=0)]
LawParameters = tuple[float, float, float]


class ResponseLevel(Document):
    """One level of the fit; levels are shares of full scale."""

    shown: float
    """Level shown."""
    seen: float
    """Level seen."""
    sigma: _Sigma | None = None
    """Standard uncertainty of the level seen, where it is known."""
    residual: float
    """Level seen minus the fitted one."""


class Region(Document):
    """One region of the camera's image and its own fit."""

    row: int
    """Row of the region in the grid of regions, from 0."""
    column: int
    """Column of the region in the grid of regions, from 0."""
    a: Positive
    """Gain."""
    b: float
    """Level seen of a dark image, as a share of full scale."""
    g: Positive
    """Exponent (gamma)."""
    sigma_g: _Sigma
    """Standard uncertainty of g."""


class Response(Curve):
    """A fitted response with its uncertainty and the levels that it was fitted to."""

    sigma: tuple[_Sigma, _Sigma, _Sigma]
    """Standard uncertainties of a, b and g."""
    residual: Annotated[float, Field(ge=0)]
    """RMS misfit as a share of full scale."""
    levels: Annotated[int, Field(ge=LIMITS.min_levels)]
    """Number of levels that were fitted."""
    covariance: tuple[LawParameters, LawParameters, LawParameters] | None = None
    """Covariance (3, 3) of a, b and g."""
    residual_sum: Annotated[float, Field(ge=0)] | None = None
    """Sum of the squares of the misfit."""
    misfit: _Sigma | None = None
    """Deviation of the law itself from the levels seen, beyond their uncertainty, as a standard deviation."""
    measured: tuple[ResponseLevel, ...] = ()
    """The levels that were fitted."""
    regions: tuple[Region, ...] = ()
    """The regions of the image that were fitted, each with its own fit."""
    region_spread: _Sigma | None = None
    """Standard deviation of the regions' g."""
    region_sigma: _Sigma | None = None
    """The part of `region_spread` that the regions' own uncertainties explain."""
    dark: tuple[float, _Sigma] | None = None
    """Level seen with the projector off, and its standard uncertainty."""
    left_out: tuple[str, ...] = ()
    """Which levels and regions were not fitted, and why."""
    prediction_errors: dict[str, float] | None = None
    """RMS error, as a share of full scale, with which `power_law` and `spline` predict a level from the
    others; the spline is chosen where chance does not explain that it is better."""

    @property
    def normalised(self) -> dict[str, float] | None:
        """The projector's own response with its white as 1, without the camera's gain and black level."""
        # `a' = a/w`, `b' = (b - dark)/w` with `w = a + b - dark`, and the standard uncertainty that both
        # share, since they add up to 1. None where the dark level was not measured.
        if self.dark is None or self.covariance is None:
            return None
        dark, sigma = self.dark
        white = self.a + self.b - dark
        if white <= 0:
            return None
        slopes = np.array([self.b - dark, -self.a, self.a]) / white**2
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = np.array(self.covariance)[:2, :2]
        covariance[2, 2] = sigma**2
        return {
            "a": self.a / white,
            "b": (self.b - dark) / white,
            "sigma": float(np.sqrt(slopes @ covariance @ slopes)),
        }

    def summary(self) -> dict[str, Any]:
        """Give the result as plain values, as the command line prints them with `--json`."""
        return {
            **self.model_dump(mode="json", exclude={"levels", "measured"}),
            "levels": [level.model_dump(mode="json") for level in self.measured],
            "normalised": self.normalised,
        }

    def save(self, path: Path) -> None:
        """Write a YAML file, whole or not at all."""
        write_text(path, config.dump(self))

    @classmethod
    def load(cls, path: Path | str) -> Response:
        return config.load_document(path, cls, "response")

    def curve(self, source: Path | str) -> Curve:
        """Give the curve alone, for correcting patterns."""
        try:
            self.check_correctable()
        except ValueError as error:
            raise ConfigError(f"{source}: {error}") from error
        if not self.spline and self.sigma[2] > LIMITS.max_sigma_g * self.g:
            raise ConfigError(
                f"{source}: 'g' is {self.g:.3g} with a standard uncertainty of {self.sigma[2]:.2g}: "
                f"at most {100 * LIMITS.max_sigma_g:g} % to correct patterns with; measure it again with "
                "more levels and light"
            )
        return Curve(a=self.a, b=self.b, g=self.g, spline=self.spline)


def with_named_response(data: Any, source: Path) -> Any:
    """Put the values of a response file in place of its name."""
    if not (isinstance(data, dict) and isinstance(data.get("response"), str)):
        return data
    file = Path(config.resolve_relative_to(data["response"], source.parent))
    try:
        curve = Response.load(file).curve(file)
    except ConfigError as error:
        raise ConfigError(
            f"{source}: 'response' must name a file written by `fpplab gamma`: {error}"
        ) from error
    return {**data, "response": curve.model_dump()}


def fit_response(
    levels_in: ArrayLike,
    levels_out: ArrayLike,
    sigma_out: ArrayLike | None = None,
    saturation: float = 0.99,
    saturated: ArrayLike | None = None,
    power_only: bool = False,
) -> Response:
    """Fit the response by nonlinear least squares, weighted by `1/sigma_out²` where given.

    A monotone spline takes the place of the power law where it predicts levels that were left out better than
    chance explains (`fpplab.patterns.response_spline`).

    With `sigma_out`, a misfit that it does not explain is added to every level as a further, equal variance,
    chosen so that chi² equals its degrees of freedom: levels known to a millionth must not bend the curve
    where no law holds to a millionth.
    """
    # levels_in (n,); levels_out (n,); sigma_out (n,); saturated (n,)
    shown, recorded = _levels("levels_in", levels_in), _levels("levels_out", levels_out)
    sigma = None if sigma_out is None else np.asarray(sigma_out, np.float64)
    if shown.shape != recorded.shape or (sigma is not None and sigma.shape != recorded.shape):
        raise CalibrationError("the levels shown, seen and their uncertainties must be as many")
    if sigma is not None and not (np.all(np.isfinite(sigma)) and np.all(sigma > 0)):
        raise CalibrationError("'sigma_out' must be positive for every level")
    clipped: Mask = np.zeros(recorded.shape, bool) if saturated is None else np.asarray(saturated, bool)
    kept = (recorded < saturation) & ~clipped
    left_out = tuple(
        f"level {i:.4g} is seen as {o:.4g}: saturated, "
        + (f"at or above {saturation:g}" if o >= saturation else "in some of its pixels")
        for i, o in zip(shown[~kept], recorded[~kept], strict=True)
    )
    _fit_for_use(shown[kept], recorded[kept], left_out)
    return _fit(shown[kept], recorded[kept], None if sigma is None else sigma[kept], left_out, power_only)


def _levels(name: str, values: ArrayLike) -> Floats:
    levels = np.asarray(values, np.float64)
    if levels.ndim != 1 or not np.all((levels >= 0) & (levels <= 1)):
        raise CalibrationError(f"'{name}' must be a row of levels from 0 to 1, as shares of full scale")
    return levels


def _fit_for_use(shown: Floats, recorded: Floats, left_out: tuple[str, ...]) -> None:
    distinct = len(np.unique(shown))
    if distinct < LIMITS.min_levels:
        advice = "shorten the exposure" if left_out else "show more levels"
        raise CalibrationError(
            f"{distinct} different levels remain for the response and {len(left_out)} are saturated; "
            f"at least {LIMITS.min_levels} are needed: {advice}"
        )
    if np.corrcoef(shown, recorded)[0, 1] < 0.5 if np.ptp(recorded) > 0 else True:
        raise CalibrationError(
            "the levels seen do not rise with the levels shown; check that the camera looks at the "
            "projector's light and that the exposure is long enough"
        )


def _fit(
    shown: Floats, recorded: Floats, sigma: Floats | None, left_out: tuple[str, ...], power_only: bool
) -> Response:
    misfit = 0.0 if sigma is None else _sigma_beyond_stated(shown, recorded, sigma)
    total = None if sigma is None else np.hypot(sigma, misfit)
    (a, b, g), covariance = _least_squares(shown, recorded, total)
    if a <= 0 or g <= 0 or not np.all(np.isfinite(covariance)):
        raise CalibrationError(
            f"the levels do not follow a I^g + b: the best fit has a = {a:.3g} and g = {g:.3g}"
        )
    rest = recorded - power_law(shown, a, b, g)
    spread = np.sqrt(np.diag(covariance))
    sigmas: list[float | None] = [None] * len(shown) if sigma is None else sigma.tolist()
    response = Response(
        a=a,
        b=b,
        g=g,
        sigma=(float(spread[0]), float(spread[1]), float(spread[2])),
        covariance=_vectors(covariance),
        residual=float(np.sqrt(np.mean(rest**2))),
        residual_sum=float(np.sum(rest**2)),
        misfit=None if sigma is None else misfit,
        levels=len(shown),
        measured=tuple(
            ResponseLevel(shown=i, seen=o, sigma=s, residual=r)
            for i, o, s, r in zip(shown.tolist(), recorded.tolist(), sigmas, rest.tolist(), strict=True)
        ),
        left_out=left_out,
    )
    if power_only or (bent := fit_spline(shown, recorded, sigma)) is None:
        return response
    slopes = _slopes(shown, a, b, g) / (1.0 if total is None else total[:, None])
    leverage = np.einsum("li,ij,lj->l", slopes, np.linalg.pinv(slopes.T @ slopes), slopes)
    of_power = leave_one_out(rest, leverage)
    errors = {
        "power_law": float(np.sqrt(np.mean(of_power[1:-1] ** 2))),
        "spline": float(np.sqrt(np.mean(bent.left_out[1:-1] ** 2))),
    }
    response = response.model_copy(update={"prediction_errors": errors})
    return (
        _replace_by_spline(response, bent, sigma)
        if prefers_spline(of_power, bent.left_out, sigma)
        else response
    )


def _replace_by_spline(power: Response, bent: SplineFit, sigma: Floats | None) -> Response:
    """Replace the power law by a spline; the exponent stays, for information."""
    excess = float(np.sum(bent.residual**2)) / bent.freedom
    if sigma is not None:
        excess -= float(np.mean(sigma**2))
    covariance = np.diag([*np.square(bent.sigma), power.sigma[2] ** 2])
    measured = tuple(
        level.model_copy(update={"residual": rest})
        for level, rest in zip(power.measured, bent.residual.tolist(), strict=True)
    )
    return power.model_copy(
        update={
            "a": bent.a,
            "b": bent.b,
            "spline": bent.coefficients,
            "sigma": (*bent.sigma, power.sigma[2]),
            "covariance": _vectors(covariance),
            "residual": float(np.sqrt(np.mean(bent.residual**2))),
            "residual_sum": float(np.sum(bent.residual**2)),
            "misfit": None if sigma is None else float(np.sqrt(max(excess, 0.0))),
            "measured": measured,
        }
    )


def _sigma_beyond_stated(shown: Floats, recorded: Floats, sigma: Floats) -> float:
    """The further standard deviation of every level that makes chi² its degrees of freedom, or 0."""
    from scipy.optimize import brentq

    def excess(further: float) -> float:
        total = np.hypot(sigma, further)
        best, _ = _least_squares(shown, recorded, total)
        return float(np.sum(((recorded - power_law(shown, *best)) / total) ** 2)) - (len(shown) - 3)

    # With the whole range as deviation chi² is less than its degrees of freedom, whatever was seen.
    return float(brentq(excess, 0.0, 1.0, xtol=1e-9)) if excess(0.0) > 0 else 0.0


def _least_squares(shown: Floats, recorded: Floats, sigma: Floats | None) -> tuple[LawParameters, Floats]:
    from scipy.optimize import curve_fit

    weight = np.ones_like(recorded) if sigma is None else 1.0 / sigma
    start = min(
        (_fit_offset_and_scale(shown, recorded, weight, g) for g in np.geomspace(0.2, 6.0, 35)),
        key=lambda s: s[1],
    )[0]
    try:
        best, covariance = curve_fit(
            power_law, shown, recorded, p0=start, sigma=sigma, absolute_sigma=sigma is not None, jac=_slopes
        )
    except RuntimeError as error:
        raise CalibrationError(f"the response could not be fitted: {error}") from error
    return (float(best[0]), float(best[1]), float(best[2])), np.asarray(covariance)


def _vectors(matrix: Floats) -> tuple[LawParameters, LawParameters, LawParameters]:
    rows = [(float(x), float(y), float(z)) for x, y, z in matrix]
    return rows[0], rows[1], rows[2]


def _fit_offset_and_scale(
    shown: Floats, recorded: Floats, weight: Floats, g: float
) -> tuple[LawParameters, float]:
    """Best (a, b) for a given g, and the weighted squares it leaves."""
    basis = np.stack([shown**g, np.ones_like(shown)], axis=1) * weight[:, None]
    (a, b), *_ = np.linalg.lstsq(basis, recorded * weight, rcond=None)
    return (float(a), float(b), g), float(np.sum((recorded * weight - basis @ (a, b)) ** 2))


def _slopes(shown: Floats, a: float, _b: float, g: float) -> Floats:
    power = shown**g
    logarithm = np.log(np.where(shown > 0, shown, 1.0))
    return np.stack([power, np.ones_like(shown), a * power * logarithm], axis=1)
