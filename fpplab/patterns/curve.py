"""A response as a curve from the level shown to the level seen, its inverse, and light in proportion to it.

`I_out = a S(I_in) + b`. S rises from 0 to 1 and is either a power law, `I^g`, or a monotone cubic spline for
projectors whose response has another shape. Only S bends fringes.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from fpplab.core.config import Document, Positive
from fpplab.core.conventions import Floats
from fpplab.patterns.limits import PATTERN_LIMITS as LIMITS

DEGREE = 3  # degree of the spline (chosen: cubic)

_INVERSE = np.linspace(0.0, 1.0, 1 << 16)


class Curve(Document):
    """A response `I_out = a S(I_in) + b`."""

    a: Positive
    """Gain."""
    b: float
    """Level seen of a dark image, as a share of full scale."""
    g: Positive
    """Exponent (gamma): S is `I^g`; next to a spline that of the best power law, for information."""
    spline: tuple[float, ...] | None = None
    """S as a cubic B-spline with equally spaced knots over [0, 1]: its coefficients, from 0 to 1 and never
    falling; none for a power law."""

    @model_validator(mode="after")
    def _spline_rises(self) -> Curve:
        if not self.spline:
            return self
        coefficients = np.asarray(self.spline)
        if (
            len(coefficients) <= DEGREE
            or coefficients[0] != 0.0
            or coefficients[-1] != 1.0
            or np.any(np.diff(coefficients) < 0)
        ):
            raise ValueError(
                f"'spline' has {len(coefficients)} coefficients from {coefficients[0]:g} to "
                f"{coefficients[-1]:g}: must be at "
                f"least {DEGREE + 1} that start at 0, end at 1 and never fall"
            )
        return self

    def shape(self, levels_in: ArrayLike) -> Floats:
        """Compute S, the share of the light between black and white."""
        levels = np.asarray(levels_in, np.float64)
        return evaluate_spline(self.spline, levels) if self.spline else np.asarray(levels**self.g)

    def apply(self, levels_in: ArrayLike) -> Floats:
        return np.asarray(self.a * self.shape(levels_in) + self.b)

    def invert(self, levels_out: ArrayLike) -> Floats:
        share = (np.asarray(levels_out, np.float64) - self.b) / self.a
        if self.spline:
            return np.where((share >= 0) & (share <= 1 + 1e-12), self.correct(np.clip(share, 0, 1)), np.nan)
        return np.asarray(np.where(share >= 0, np.abs(share) ** (1.0 / self.g), np.nan))

    def correct(self, levels: ArrayLike) -> Floats:
        """Compute the levels to show so that the light rises from black to white as `levels` do."""
        # The light that can be reached is b … a + b, so `levels` are shares of that, and the result is the
        # inverse of S. Gain, black level and exposure cancel, black stays black and white stays white.
        light = np.asarray(levels, np.float64)
        if self.spline:
            return np.asarray(np.interp(light, _rising(self.spline), _INVERSE))
        return np.asarray(light ** (1.0 / self.g))

    def check_correctable(self) -> None:
        """Refuse a response whose inverse a projector cannot show."""
        if self.spline:
            jump = float(np.diff(self.shape(np.arange(256) / 255)).max())
            if jump > LIMITS.max_jump:
                raise ValueError(
                    f"'spline' rises by {jump:.2g} of white from one grey level to the next: at most "
                    f"{LIMITS.max_jump:.2g} to correct patterns with; change the projector's own tone curve"
                )
            return
        lower, upper = LIMITS.min_exponent, LIMITS.max_exponent
        if not lower <= self.g <= upper:
            raise ValueError(
                f"'g' is {self.g:g}: patterns can be corrected for an exponent of {lower:g} to {upper:g}, "
                "beyond which the projector has too few grey levels; change its own gamma setting"
            )


def knots(coefficients: int) -> Floats:
    """Give the clamped, equally spaced knots of a spline over [0, 1]."""
    ends = np.full(DEGREE, 1.0)
    return np.concatenate([0.0 * ends, np.linspace(0.0, 1.0, coefficients - DEGREE + 1), ends])


def evaluate_spline(coefficients: tuple[float, ...], levels: Floats) -> Floats:
    from scipy.interpolate import BSpline  # a power law, which most are, needs none

    spline = BSpline(knots(len(coefficients)), np.asarray(coefficients), DEGREE)
    return np.asarray(spline(np.clip(levels, 0.0, 1.0)), np.float64)


@lru_cache(maxsize=8)
def _rising(coefficients: tuple[float, ...]) -> Floats:
    return np.asarray(np.maximum.accumulate(evaluate_spline(coefficients, _INVERSE)))


def power_law(shown: Floats, a: float, b: float, g: float) -> Floats:
    """Compute `a I^g + b`."""
    return np.asarray(a * shown**g + b)
