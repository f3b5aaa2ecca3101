"""Completeness: how much of the surface is measured."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from typing_extensions import override

from fpplab.optimisation.figures import MeasuredCandidate
from fpplab.optimisation.objective import Objective, ObjectiveLimit


class Completeness(Objective):
    """Share of the true surface that is measured."""

    key = "completeness"
    title = "Completeness"
    sentence = "share of the true surface that has a measured point nearby"
    number_format = ".4f"
    is_maximised = True
    limit = ObjectiveLimit(
        "completeness_of_start",
        Annotated[float, Field(ge=0, le=1)],
        0.95,
        "Least completeness, as a multiple of the start's.",
    )

    @override
    def value(self, candidate: MeasuredCandidate) -> float:
        return candidate.figures.completeness

    @override
    def excess(self, value: float, of_start: float, limit: float) -> float:
        return limit * of_start - value
