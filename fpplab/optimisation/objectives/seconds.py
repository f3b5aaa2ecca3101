"""Seconds: how long a measurement takes."""

from __future__ import annotations

from typing_extensions import override

from fpplab.core.config import Positive
from fpplab.optimisation.figures import MeasuredCandidate
from fpplab.optimisation.objective import Objective, ObjectiveLimit


class Seconds(Objective):
    """Acquisition time of a measurement."""

    key = "seconds"
    title = "Acquisition time"
    unit = "s"
    sentence = "acquisition time of a measurement on projector and camera"
    limit = ObjectiveLimit("seconds", Positive | None, None, "Longest acquisition time.")

    @override
    def value(self, candidate: MeasuredCandidate) -> float:
        return candidate.figures.seconds

    @override
    def excess(self, value: float, of_start: float, limit: float) -> float:
        return value / limit - 1.0
