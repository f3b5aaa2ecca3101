"""The result of `fpplab optimise`: a search, whether to believe its optimum, and what it changes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fpplab.clouds import Cloud
from fpplab.comparison import Comparison
from fpplab.diagnosis import Diagnosis
from fpplab.optimisation.confirm import ConfirmedPlan
from fpplab.optimisation.result import SearchResult
from fpplab.results.provenance import Provenance


@dataclass(frozen=True, eq=False)
class MeasuredArtefact:
    """An artefact as a plan measures it."""

    cloud: Cloud
    comparison: Comparison


@dataclass(frozen=True, eq=False)
class BeforeAndAfter:
    """What is measured on the rig of a search when it is over."""

    artefacts: Mapping[str, tuple[MeasuredArtefact, MeasuredArtefact]] = field(default_factory=dict)
    """By name, with the start's plan and with the plan found."""
    angles_deg: Mapping[float, float] = field(default_factory=dict)
    """Angles of triangulation by the stage's position in mm."""
    provenance: Mapping[str, Provenance] = field(default_factory=dict)  # of the rig, with the start's plan


@dataclass(frozen=True, eq=False)
class OptimisationResult:
    """A search, its verdict, and its optimum compared with the start."""

    search: SearchResult
    diagnosis: Diagnosis
    report_file: Path
    confirmed: tuple[ConfirmedPlan, ...] = ()  # plans that were compared on another rig
    seconds: float = 0.0  # time that the search and its confirmation took
    compared: BeforeAndAfter = field(default_factory=BeforeAndAfter)

    def summary(self) -> dict[str, Any]:
        return {
            **self.diagnosis.summary(),
            **self.search.summary(),
            "confirmed": [plan.summary() for plan in self.confirmed],
            "seconds": self.seconds,
            "plans": [] if self.diagnosis.is_useless else [str(path) for path in self.search.plans],
            "report": str(self.report_file),
            "provenance": {name: origin.summary() for name, origin in self.compared.provenance.items()},
        }
