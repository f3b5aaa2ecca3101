"""Lengths of an artefact as a scan will show them, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fpplab.artefacts.recognition import recognise
from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison.lengths import measure_lengths
from fpplab.core.conventions import Floats
from fpplab.reconstruction.triangulation import CoordinateNoise
from fpplab.reconstruction.uncertainty import displacements_by_mode
from sim.prediction.discrepancy import COVERAGE
from sim.prediction.figures import SeenShape
from sim.prediction.intervals import FigureInterval, of_one_measurement

MOVED_POINTS = 10_000  # by which effects of a calibration are found, which change slowly over a face (chosen)


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

    def measured(points: Floats) -> Floats:
        found = measure_lengths(pose.apply(points), pose.translation, lengths)
        return np.array([np.nan if one.measured_mm is None else one.measured_mm for one in found])

    on_it = [cloud.points[shape.on_it(cloud)].astype(np.float64) for cloud in clouds]
    draws = np.array([measured(points) for points in on_it])
    variances = np.array([of_one_measurement(drawn) ** 2 for drawn in draws.T]) + off_mm**2
    if calibration.uncertainty is not None:
        few = on_it[0][:: max(1, len(on_it[0]) // MOVED_POINTS)]
        unmoved = measured(few)
        for mode in np.moveaxis(displacements_by_mode(few, calibration, noise), -1, 0):
            variances += (measured(few + mode) - unmoved) ** 2
    middle, reach = np.median(draws, axis=0), COVERAGE * np.sqrt(variances)
    return tuple(
        PredictedLength(length.name, length.true_mm, FigureInterval(at, at - off, at + off))
        for length, at, off in zip(lengths, middle.tolist(), reach.tolist(), strict=True)
        if np.isfinite(at + off)
    )
