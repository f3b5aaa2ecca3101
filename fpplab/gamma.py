"""The response of projector and camera together: from the level shown to the level seen.

`I_out = a I_in^g + b`, levels as shares of full scale: a is the gain, b the level seen of a
dark picture, g the exponent (gamma).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field
from scipy.optimize import curve_fit

from fpplab import config
from fpplab.config import Document
from fpplab.conventions import Floats
from fpplab.errors import CalibrationError
from fpplab.files import write_text

LEAST_LEVELS = 5
"""Three parameters, and something left to judge the fit by."""

Positive = Annotated[float, Field(gt=0)]
Sigma = Annotated[float, Field(ge=0)]


class Response(Document):
    """A fitted response.

    a, b, g: of `I_out = a I_in^g + b`. sigma: their standard uncertainties. residual: RMS misfit
    as a share of full scale. levels: how many were fitted; left_out: which were not, and why.
    """

    a: Positive
    b: float
    g: Positive
    sigma: tuple[Sigma, Sigma, Sigma]
    residual: Annotated[float, Field(ge=0)]
    levels: Annotated[int, Field(ge=LEAST_LEVELS)]
    left_out: tuple[str, ...] = ()

    def apply(self, levels_in: ArrayLike) -> Floats:
        """Levels seen for levels shown in [0, 1]."""
        return _model(np.asarray(levels_in, np.float64), self.a, self.b, self.g)

    def invert(self, levels_out: ArrayLike) -> Floats:
        """Levels shown for levels seen; NaN below b, which no level shown gives."""
        share = (np.asarray(levels_out, np.float64) - self.b) / self.a
        return np.asarray(np.where(share >= 0, np.abs(share) ** (1.0 / self.g), np.nan))

    def summary(self) -> dict[str, Any]:
        """The figures for a machine to read, as the command line prints them."""
        return self.model_dump(mode="json", include={"a", "b", "g", "residual", "sigma"})

    def save(self, path: Path) -> None:
        """Write as YAML, whole or not at all."""
        write_text(path, config.dump(self))

    @classmethod
    def load(cls, path: Path | str) -> Response:
        """Read a response file. Raises `ConfigError`."""
        return config.load(path, cls)


def fit_response(
    levels_in: ArrayLike,
    levels_out: ArrayLike,
    sigma_out: ArrayLike | None = None,
    saturation: float = 0.99,
) -> Response:
    """Fit the response by nonlinear least squares, weighted by `1/sigma_out²` where given.

    levels_in, levels_out, sigma_out: (n,) shares of full scale, shown, seen, and the standard
    uncertainty of what was seen; without it the uncertainties come from the misfit.
    saturation: levels seen at or above it are left out, and named in `Response.left_out`.

    Raises `CalibrationError` when the levels are no levels, too few remain, or they do not rise.
    """
    shown, seen = _levels("levels_in", levels_in), _levels("levels_out", levels_out)
    sigma = None if sigma_out is None else np.asarray(sigma_out, np.float64)
    if shown.shape != seen.shape or (sigma is not None and sigma.shape != seen.shape):
        raise CalibrationError("the levels shown, seen and their uncertainties must be as many")
    if sigma is not None and not (np.all(np.isfinite(sigma)) and np.all(sigma > 0)):
        raise CalibrationError("'sigma_out' must be positive for every level")
    kept = seen < saturation
    left_out = tuple(
        f"level {i:.4g} is seen as {o:.4g}: saturated, at or above {saturation:g}"
        for i, o in zip(shown[~kept], seen[~kept], strict=True)
    )
    _fit_for_use(shown[kept], seen[kept], left_out)
    return _fit(shown[kept], seen[kept], None if sigma is None else sigma[kept], left_out)


def _levels(name: str, values: ArrayLike) -> Floats:
    levels = np.asarray(values, np.float64)
    if levels.ndim != 1 or not np.all((levels >= 0) & (levels <= 1)):
        raise CalibrationError(f"'{name}' must be a row of levels from 0 to 1, as shares of full scale")
    return levels


def _fit_for_use(shown: Floats, seen: Floats, left_out: tuple[str, ...]) -> None:
    distinct = len(np.unique(shown))
    if distinct < LEAST_LEVELS:
        advice = "shorten the exposure" if left_out else "show more levels"
        raise CalibrationError(
            f"{distinct} different levels remain for the response and {len(left_out)} are saturated; "
            f"at least {LEAST_LEVELS} are needed: {advice}"
        )
    if np.corrcoef(shown, seen)[0, 1] < 0.5 if np.ptp(seen) > 0 else True:
        raise CalibrationError(
            "the levels seen do not rise with the levels shown; check that the camera looks at the "
            "projector's light and that the exposure is long enough"
        )


def _fit(shown: Floats, seen: Floats, sigma: Floats | None, left_out: tuple[str, ...]) -> Response:
    weight = np.ones_like(seen) if sigma is None else 1.0 / sigma
    start = min((_linear(shown, seen, weight, g) for g in np.geomspace(0.2, 6.0, 35)), key=lambda s: s[1])[0]
    try:
        best, covariance = curve_fit(
            _model, shown, seen, p0=start, sigma=sigma, absolute_sigma=sigma is not None, jac=_slopes
        )
    except RuntimeError as error:
        raise CalibrationError(f"the response could not be fitted: {error}") from error
    a, b, g = (float(p) for p in best)
    if a <= 0 or g <= 0 or not np.all(np.isfinite(covariance)):
        raise CalibrationError(
            f"the levels do not follow a I^g + b: the best fit has a = {a:.3g} and g = {g:.3g}"
        )
    spread = np.sqrt(np.diag(covariance))
    residual = float(np.sqrt(np.mean((seen - _model(shown, a, b, g)) ** 2)))
    return Response(
        a=a,
        b=b,
        g=g,
        sigma=(float(spread[0]), float(spread[1]), float(spread[2])),
        residual=residual,
        levels=len(shown),
        left_out=left_out,
    )


def _linear(
    shown: Floats, seen: Floats, weight: Floats, g: float
) -> tuple[tuple[float, float, float], float]:
    """Best (a, b) for a given g, and the weighted squares it leaves."""
    basis = np.stack([shown**g, np.ones_like(shown)], axis=1) * weight[:, None]
    (a, b), *_ = np.linalg.lstsq(basis, seen * weight, rcond=None)
    return (float(a), float(b), g), float(np.sum((seen * weight - basis @ (a, b)) ** 2))


def _model(shown: Floats, a: float, b: float, g: float) -> Floats:
    return np.asarray(a * shown**g + b)


def _slopes(shown: Floats, a: float, _b: float, g: float) -> Floats:
    power = shown**g
    logarithm = np.log(np.where(shown > 0, shown, 1.0))
    return np.stack([power, np.ones_like(shown), a * power * logarithm], axis=1)
