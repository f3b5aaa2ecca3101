"""How a bent response bends phases, and phases and images without it.

A power law gives a sinusoid harmonics of known strength. Images of N steps see those of order kN ± 1 as an
error of the phase that repeats N times in a fringe, whatever the order of the steps and sets is: so a
response is found before the plan is judged.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import TWO_PI, Floats, phase_steps
from fpplab.diagnosis.plan.limits import PlanCheckLimits
from fpplab.patterns.phase_error import harmonics

HIGHEST = 12
"""Highest harmonic that counts. Derived: of exponents up to 3 further ones are below 1e-4 of the fringe."""
EXPONENTS = np.linspace(0.4, 3.5, 156)  # exponents that are tried (chosen)
SECOND_HARMONICS = (-0.25, 0.45)
"""Least and greatest second harmonic of these exponents, as a share of the fringe. Derived: (g-1)/(g+2)."""
MAX_UNEVENNESS = 0.3  # how unevenly phases may be spread over a period, and how asymmetrically (chosen)
_PHASES = TWO_PI * np.arange(720) / 720


@dataclass(frozen=True)
class Bend:
    """The response of a power law."""

    exponent: float

    @cached_property
    def _relative(self) -> Floats:
        """Strength of each harmonic beside the fringe, from the fringe on."""
        amplitudes = harmonics(self.exponent, HIGHEST)[1:]
        return np.asarray(amplitudes / amplitudes[0])

    def _observed(self, steps: int) -> NDArray[np.complex128]:
        """Sinusoid (720,) that N steps show of fringes at phases over a period, as complex numbers."""
        phasors = np.zeros(len(_PHASES), np.complex128)
        for order, strength in enumerate(self._relative, 1):
            if order % steps == 1:
                phasors += strength * np.exp(1j * order * _PHASES)
            if order % steps == steps - 1:
                phasors += strength * np.exp(-1j * order * _PHASES)
        return phasors

    def mean_turn(self, steps: int) -> float:
        """Compute the mean of exp(iN times the phase) over fringes, which is 0 with a straight response."""
        phasors = self._observed(steps)
        return float(np.mean((phasors / np.abs(phasors)) ** steps).real)

    def straightened(self, phases: Floats, steps: int) -> Floats:
        """Give the phases that fringes have where N steps show these."""
        observed = np.unwrap(np.angle(self._observed(steps)))
        errors = observed - _PHASES
        return np.asarray(phases - np.interp(phases % TWO_PI, observed % TWO_PI, errors, period=TWO_PI))

    def straightened_levels(self, levels: Floats) -> Floats:
        """Take the harmonics out of a set's images."""
        # levels (N, ...); returns the same
        count = len(levels)
        shifts = phase_steps(count).reshape(-1, *(1,) * (levels.ndim - 1))
        phasors = np.sum(np.exp(1j * shifts) * levels, axis=0) * (2.0 / count)
        phases = self.straightened(np.angle(phasors), count)
        amplitude = np.abs(np.interp(phases % TWO_PI, _PHASES, np.abs(self._observed(count)), period=TWO_PI))
        strength = np.abs(phasors) / np.maximum(amplitude, 0.1)
        waves = [
            share * np.cos(order * (phases - shifts)) for order, share in enumerate(self._relative[1:], 2)
        ]
        return np.asarray(levels - strength * np.sum(waves, axis=0))


def fitted_bends(sets: Sequence[Floats], limits: PlanCheckLimits) -> tuple[Bend, ...] | None:
    """Find the power law that bends the images of each set; None where the images show none."""
    # Blur takes more of the harmonics of fine fringes, so that each set has an exponent of its own. Where a
    # set does not show it, that of the widest fringes is taken which do.
    # sets (N, P) each, of pixels that see the fringes, in the order of the plan
    own = [_exponent_of_many(levels) if len(levels) > 3 else _exponent_of_three(levels) for levels in sets]
    known = [exponent for exponent in own if exponent is not None]
    if not known or max(abs(exponent - 1.0) for exponent in known) < limits.min_bend:
        return None
    return tuple(Bend(known[0] if exponent is None else exponent) for exponent in own)


def _exponent_of_many(levels: Floats) -> float | None:
    """Measure the second harmonic, which four images and more show besides the fringe."""
    shifts = phase_steps(len(levels))[:, None]
    phasors = np.sum(np.exp(1j * shifts) * levels, axis=0) * (2.0 / len(levels))
    angles = np.angle(phasors) - shifts
    second = np.abs(phasors) * np.cos(2.0 * angles)
    residuals = levels - levels.mean(axis=0) - np.abs(phasors) * np.cos(angles)
    second = second - second.mean(axis=0)
    power = float(np.vdot(second, second))
    if power <= 0.0:
        return None
    share = float(np.clip(np.vdot(residuals, second) / power, *SECOND_HARMONICS))
    return (1.0 + 2.0 * share) / (1.0 - share)


def _exponent_of_three(levels: Floats) -> float | None:
    """Measure how often three images show each phase: phases of many fringes are spread evenly."""
    phasors = np.sum(np.exp(1j * phase_steps(len(levels)))[:, None] * levels, axis=0)
    turns = phasors / np.maximum(np.abs(phasors), 1e-12)
    mean = complex(np.mean(turns ** len(levels)))
    # A response bends symmetrically about the crest of a fringe; a part with few phases does not.
    if abs(np.mean(turns)) > MAX_UNEVENNESS or abs(mean.imag) > MAX_UNEVENNESS * abs(mean):
        return None
    predicted = np.array([Bend(float(g)).mean_turn(len(levels)) for g in EXPONENTS])
    return float(EXPONENTS[np.argmin(np.abs(predicted - mean.real))])
