"""What `fpplab optimise` can search, by the names of the command line."""

from enum import StrEnum
from typing import Literal

ParameterGroup = Literal["steps", "stripes", "codes", "geometry", "light"]


class SearchScope(StrEnum):
    """What a search varies, as named on the command line."""

    PHASES = "phases"
    STRIPES = "stripes"
    BASELINE = "baseline"
    PARETO = "pareto"

    @property
    def groups(self) -> tuple[ParameterGroup, ...]:
        return _GROUPS[self]


_GROUPS: dict[SearchScope, tuple[ParameterGroup, ...]] = {
    SearchScope.PHASES: ("steps", "codes", "light"),
    SearchScope.STRIPES: ("stripes", "codes", "light"),
    SearchScope.BASELINE: ("geometry",),
    SearchScope.PARETO: ("steps", "stripes", "codes", "geometry", "light"),
}
