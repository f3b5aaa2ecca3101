"""Intervals of predicted figures: what is not known of the bench, drawn many times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import erfc, erfcinv, ndtri

from fpplab.core.conventions import Floats
from sim.prediction.discrepancy import COVERAGE, Discrepancy
from sim.prediction.figures import MeasuredFigures


@dataclass(frozen=True)
class FigureInterval:
    """A predicted figure with its interval of 95 %."""

    value: float  # in the unit of the figure
    low: float  # in the unit of the figure
    high: float  # in the unit of the figure

    def contains(self, measured: float) -> bool:
        return self.low <= measured <= self.high

    def summary(self) -> dict[str, float]:
        return {"value": self.value, "low": self.low, "high": self.high}


def figure_intervals(
    draws: Sequence[MeasuredFigures],
    by_calibration: Floats,
    discrepancy: Discrepancy,
    of_surface: float,
    stripes: float,
) -> dict[str, FigureInterval]:
    """Compute intervals by noise, calibration, surface, and what bench and twin differed by."""
    # Flicker and vibration now and then make a measurement much worse, so that distance and noise are the
    # medians of their draws. The noise of a surface is at most inversely proportional to its reflectance.
    # by_calibration (K,)
    values = {name: np.array([getattr(drawn, name) for drawn in draws]) for name in draws[0].summary()}
    # Of one measurement about the middle of the draws.
    spread = {
        name: float(drawn.std(ddof=1) * np.sqrt(1.0 + 1.0 / len(drawn))) for name, drawn in values.items()
    }
    usual = {name: float(np.median(drawn)) for name, drawn in values.items()}
    relative = {name: spread[name] / max(usual[name], 1e-12) for name in usual}
    contrast = discrepancy.contrast.sigma(stripes) if discrepancy.contrast else 0.0
    light = float(np.hypot(of_surface, contrast))
    noise = float(np.hypot(discrepancy.noise.sigma if discrepancy.noise else 0.0, light))
    distance = float(np.hypot(discrepancy.distance.sigma, light)) if discrepancy.distance else noise
    share = discrepancy.completeness.sigma if discrepancy.completeness else 0.0
    reach = COVERAGE * float(np.hypot(spread["completeness"], share))
    complete, risk = (float(values[name].mean()) for name in ("completeness", "wrong_order"))
    return {
        "distance_um": _interval_with_factor(
            usual["distance_um"] * by_calibration, float(np.hypot(relative["distance_um"], distance))
        ),
        "noise_um": _interval_with_factor(
            np.array([usual["noise_um"]]), float(np.hypot(relative["noise_um"], noise))
        ),
        "completeness": FigureInterval(complete, max(0.0, complete - reach), min(1.0, complete + reach)),
        # The risk falls like exp(-d²/2) in the noise: it is bounded by that of a noise that is off.
        "wrong_order": FigureInterval(risk, *_risk_ends(risk, noise + relative["noise_um"])),
    }


def _interval_with_factor(values: Floats, relative: float) -> FigureInterval:
    """Median and interval of equally likely values that a log-normal factor multiplies."""
    steps = (np.arange(1_000) + 0.5) / 1_000  # equally likely
    factors = np.exp(relative * ndtri(steps))
    low, high = np.quantile(values[:, None] * factors, (0.025, 1.0 - 0.025))
    return FigureInterval(float(np.median(values)), float(low), float(high))


def _risk_ends(risk: float, relative: float) -> tuple[float, float]:
    """Ends of the probability of a wrong order, where the noise is off by a relative standard deviation."""
    distance = float(erfcinv(min(max(risk, 1e-300), 1.0)))
    factor = float(np.exp(COVERAGE * relative))
    low, high = float(erfc(distance * factor)), float(erfc(distance / factor))
    return min(low, risk), max(high, risk)  # the smallest numbers are rounded to nothing
