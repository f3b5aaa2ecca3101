"""Surface SMCD: the symmetric mean distance between points and surface."""

from __future__ import annotations

from typing_extensions import override

from fpplab.core.config import Positive
from fpplab.optimisation.figures import MeasuredCandidate
from fpplab.optimisation.objective import Objective, ObjectiveLimit


class SurfaceSmcd(Objective):
    """Symmetric mean distance between points and true surface."""

    key = "surface_smcd_um"
    title = "Surface SMCD"
    unit = "µm"
    sentence = "symmetric mean distance between points and true surface"
    limit = ObjectiveLimit(
        "smcd_of_start",
        Positive | None,
        None,
        "Greatest mean distance to the surface, as a multiple of the start's.",
    )

    @override
    def value(self, candidate: MeasuredCandidate) -> float:
        return candidate.figures.surface_smcd_um

    @override
    def spread(self, candidate: MeasuredCandidate) -> float | None:
        return candidate.figures.smcd_spread_um

    @override
    def excess(self, value: float, of_start: float, limit: float) -> float:
        return value / (limit * of_start) - 1.0
