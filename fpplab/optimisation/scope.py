"""What can be searched, by the names of the command line."""

from __future__ import annotations

from enum import StrEnum
from typing import Literal

ParameterGroup = Literal["steps", "stripes", "geometry", "light"]
"""Parameters that belong together."""


class SearchScope(StrEnum):
    """A search."""

    PHASES = "phases"
    STRIPES = "stripes"
    BASELINE = "baseline"
    PARETO = "pareto"

    @property
    def groups(self) -> tuple[ParameterGroup, ...]:
        """The parameters that it may have."""
        return _GROUPS[self]


_GROUPS: dict[SearchScope, tuple[ParameterGroup, ...]] = {
    SearchScope.PHASES: ("steps",),
    SearchScope.STRIPES: ("stripes",),
    SearchScope.BASELINE: ("geometry",),
    SearchScope.PARETO: ("steps", "stripes", "geometry", "light"),
}
