"""Intervals of predicted figures: what is not known of the bench, drawn many times."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import erfc, erfcinv, ndtri

from fpplab.artefacts.recognition import recognise
from fpplab.calibration.displacements import CoordinateNoise
from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison.lengths import MeasuredLength, displacements_by, measure_lengths
from fpplab.core.conventions import Floats
from sim.prediction.discrepancy import COVERAGE, USUAL_DISTANCE, USUAL_NOISE, USUAL_SHARE, Discrepancy
from sim.prediction.figures import MeasuredFigures, SeenShape
from sim.prediction.form import DRAWS, CalibrationEffects


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
    effects: CalibrationEffects,
    discrepancy: Discrepancy,
    by_surface: Floats,
    stripes: float,
) -> dict[str, FigureInterval]:
    """Compute intervals by noise, calibration, surface, and what bench and twin differed by."""
    # Flicker and vibration now and then make a measurement much worse, so that distance and noise are the
    # medians of their draws. by_surface (K,) are equally likely factors of the noise, in any order.
    values = {name: np.array([getattr(drawn, name) for drawn in draws]) for name in draws[0].summary()}
    spread = {name: of_one_measurement(drawn) for name, drawn in values.items()}
    usual = {name: float(np.median(drawn)) for name, drawn in values.items()}
    relative = {name: spread[name] / max(usual[name], 1e-12) for name in usual}
    contrast = discrepancy.contrast.sigma(stripes) if discrepancy.contrast else 0.0
    noise = float(np.hypot(discrepancy.noise.sigma(USUAL_NOISE) if discrepancy.noise else 0.0, contrast))
    distance = float(np.hypot(distance_sigma(discrepancy), contrast)) if discrepancy.distance else noise
    share = discrepancy.completeness.sigma(USUAL_SHARE) if discrepancy.completeness else 0.0
    reach = COVERAGE * float(np.hypot(spread["completeness"], share))
    complete, risk = (float(values[name].mean()) for name in ("completeness", "wrong_order"))
    noise_um = _interval_with_factor(
        usual["noise_um"], by_surface, float(np.hypot(relative["noise_um"], noise))
    )
    expected = usual["distance_um"] * float(np.median(effects.distance))
    of_distance = np.resize(effects.distance, DRAWS) / np.median(effects.distance)
    return {
        "distance_um": _interval_with_factor(
            expected,
            of_distance * np.random.default_rng(0).choice(by_surface, DRAWS),
            float(np.hypot(relative["distance_um"], distance)),
        ),
        "place_um": FigureInterval(*np.quantile(effects.place_um, (0.5, 0.025, 0.975)).tolist()),
        "noise_um": noise_um,
        "completeness": FigureInterval(complete, max(0.0, complete - reach), min(1.0, complete + reach)),
        # The risk falls like exp(-d²/2) in the noise: it is bounded by that of a noise that is off.
        "wrong_order": FigureInterval(risk, *_risk_ends(risk, noise_um)),
    }


def of_one_measurement(values: Floats) -> float:
    """Standard deviation of one measurement about the middle of some draws (n,)."""
    return float(values.std(ddof=1) * np.sqrt(1.0 + 1.0 / len(values)))


def distance_sigma(discrepancy: Discrepancy) -> float:
    """Relative standard deviation of distances by what bench and twin differed by."""
    return discrepancy.distance.sigma(USUAL_DISTANCE) if discrepancy.distance else 0.0


def _interval_with_factor(value: float, likely: Floats, relative: float) -> FigureInterval:
    """Interval of a value times equally likely factors (K,) and a log-normal one."""
    factors = np.exp(relative * ndtri((np.arange(1_000) + 0.5) / 1_000))
    low, high = np.quantile(likely[:, None] * factors, (0.025, 1.0 - 0.025))
    return FigureInterval(value, value * float(low), value * float(high))


def _risk_ends(risk: float, noise: FigureInterval) -> tuple[float, float]:
    """Ends of the probability of a wrong order, by those of the noise."""
    distance = float(erfcinv(min(max(risk, 1e-300), 1.0)))
    low, high = (float(erfc(distance * noise.value / end)) for end in (noise.low, noise.high))
    return min(low, risk), max(high, risk)  # the smallest numbers are rounded to nothing


@dataclass(frozen=True)
class PredictedLength:
    """A length of the true shape, and what a scan will give for it."""

    name: str  # as the artefact calls it
    true_mm: float
    measured_mm: FigureInterval

    def summary(self) -> dict[str, object]:
        return {"name": self.name, "true_mm": self.true_mm, **self.measured_mm.summary()}


def predicted_lengths(
    clouds: Sequence[Cloud], shape: SeenShape, calibration: Calibration, noise: CoordinateNoise, off_mm: float
) -> tuple[PredictedLength, ...]:
    """Measure lengths in draws of a scan; `off_mm` is how far a face of the bench may be from the twin's."""
    placed = recognise(shape.mesh)
    if placed is None:
        return ()
    pose, lengths = placed.pose.inverse(), placed.artefact.lengths()
    displacements = displacements_by(calibration, placed.pose, noise)

    def measured(cloud: Cloud) -> tuple[MeasuredLength, ...]:
        points = pose.apply(cloud.points[shape.on_it(cloud)].astype(np.float64))
        return measure_lengths(points, pose.translation, lengths, displacements)

    measurements = [measured(cloud) for cloud in clouds]
    draws = np.array(
        [[np.nan if m.measured_mm is None else m.measured_mm for m in of_cloud] for of_cloud in measurements]
    )
    variances = np.array([of_one_measurement(drawn) ** 2 for drawn in draws.T]) + off_mm**2
    variances += [(1e-3 * m.sigma_calibration_um) ** 2 for m in measurements[0]]
    middle, reach = np.median(draws, axis=0), COVERAGE * np.sqrt(variances)
    return tuple(
        PredictedLength(length.name, length.true_mm, FigureInterval(at, at - off, at + off))
        for length, at, off in zip(lengths, middle.tolist(), reach.tolist(), strict=True)
        if np.isfinite(at + off)
    )
