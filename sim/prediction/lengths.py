"""Lengths of an artefact as a scan will show them, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fpplab.artefacts.recognition import recognise
from fpplab.calibration.displacements import CoordinateNoise
from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison.lengths import MeasuredLength, displacements_by, measure_lengths
from sim.prediction.discrepancy import COVERAGE
from sim.prediction.figures import SeenShape
from sim.prediction.intervals import FigureInterval, of_one_measurement


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

    found = [measured(cloud) for cloud in clouds]
    draws = np.array([[np.nan if m.measured_mm is None else m.measured_mm for m in one] for one in found])
    variances = np.array([of_one_measurement(drawn) ** 2 for drawn in draws.T]) + off_mm**2
    variances += [(1e-3 * m.sigma_calibration_um) ** 2 for m in found[0]]
    middle, reach = np.median(draws, axis=0), COVERAGE * np.sqrt(variances)
    return tuple(
        PredictedLength(length.name, length.true_mm, FigureInterval(at, at - off, at + off))
        for length, at, off in zip(lengths, middle.tolist(), reach.tolist(), strict=True)
        if np.isfinite(at + off)
    )
