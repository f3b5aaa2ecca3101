"""What can be searched, by the names of the command line."""

from __future__ import annotations

from enum import StrEnum
from typing import Literal

Group = Literal["steps", "stripes", "geometry", "light"]
"""Parameters that belong together."""


class Goal(StrEnum):
    """A search."""

    PHASES = "phases"
    STRIPES = "stripes"
    BASELINE = "baseline"
    PARETO = "pareto"

    @property
    def groups(self) -> tuple[Group, ...]:
        """The parameters that it may have."""
        return _GROUPS[self]


_GROUPS: dict[Goal, tuple[Group, ...]] = {
    Goal.PHASES: ("steps",),
    Goal.STRIPES: ("stripes",),
    Goal.BASELINE: ("geometry",),
    Goal.PARETO: ("steps", "stripes", "geometry", "light"),
}
