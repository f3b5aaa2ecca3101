"""Worst SMCD: the distance between points and surface for the worst seed."""

from __future__ import annotations

from typing_extensions import override

from fpplab.optimisation.figures import MeasuredCandidate
from fpplab.optimisation.objective import Objective


class WorstSmcd(Objective):
    """Symmetric mean distance between points and true surface for the worst seed."""

    key = "worst_smcd_um"
    title = "Worst seed"
    unit = "µm"
    sentence = (
        "surface SMCD of the seed for which it is greatest; where every seed draws a matched twin within its "
        "uncertainty, that of the worst of these twins"
    )

    @override
    def value(self, candidate: MeasuredCandidate) -> float:
        return candidate.figures.worst_smcd_um
