"""Candidates of a search, the scores that measuring them gives, and the interface of what measures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from fpplab.patterns.fringe_sets import AnySet
from fpplab.patterns.plan import Plan

Point = tuple[float, ...]
"""Point of a search space: one value for each parameter, in its unit; for the axis its index."""


@dataclass(frozen=True)
class Candidate:
    """One arrangement that a search can try."""

    fringes: tuple[AnySet, ...]  # sets of patterns; of fringes the base first
    exposure_s: float  # exposure of every image in seconds
    stage_mm: float | None = None  # position of the stage that moves a device, which sets the baseline
    convergence_deg: float | None = None  # rotation of the projector towards the camera in degrees
    exposures_s: tuple[float, ...] | None = None  # in place of the exposure, where each image has several

    @classmethod
    def of(cls, plan: Plan) -> Candidate:
        plan.refuse_set_exposures("a search")
        return cls(plan.sets, plan.exposure_s, plan.stage_mm, exposures_s=plan.exposures_s)

    @property
    def images(self) -> int:
        return sum(each.images for each in self.fringes)

    @property
    def exposures(self) -> tuple[float, ...]:
        return self.exposures_s or (self.exposure_s,)

    def seconds(self, other_s: float) -> float:
        """Time of all images, of which each takes `other_s` beside its exposure."""
        return self.images * sum(exposure_s + other_s for exposure_s in self.exposures)

    @property
    def pattern_bits(self) -> int:
        """Most bits in which images are projected."""
        return max(each.bit_depth for each in self.fringes)

    def plan(self, template: Plan) -> Plan:
        changed = {"fringes": self.fringes, "exposure_s": self.exposure_s, "stage_mm": self.stage_mm}
        return template.model_copy(update={**changed, "exposures_s": self.exposures_s})


def candidate_fields(candidate: Candidate) -> dict[str, Any]:
    """Describe a candidate in JSON."""
    sets = [each.model_dump(mode="json", exclude_none=True) for each in candidate.fringes]
    return {**vars(candidate), "fringes": sets}


@dataclass(frozen=True)
class Accuracy:
    """Deviation of a measurement from the true shape, as `fpplab.comparison` defines it."""

    points: int  # measured points that lie on the shape
    surface_smcd_um: float  # symmetric mean distance between points and true surface in µm
    smcd_um: float  # symmetric mean Chamfer distance between measured and sampled true points in µm
    smcd_floor_um: float  # what a perfect measurement would have for `smcd_um`, in µm
    surface_rms_um: float  # root mean square distance of the points from the true surface in µm
    completeness: float  # share of the true surface that has a measured point nearby, 0 … 1
    wrong_orders: float
    outliers: float  # share of points that the outlier filter removed, 0 … 1


@dataclass(frozen=True)
class Score(Accuracy):
    """The result of measuring one artefact once with one candidate."""

    artefact: str  # name of the artefact
    seed: int  # seed of the noise on a simulation, number of the repeat on a real rig
    images: int  # images that the measurement took
    seconds: float  # acquisition time on the projector and camera


class Evaluator(Protocol):
    """Interface of what measures candidates, on whatever rig."""

    def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
        """Measure every artefact of the study; on a simulation equal arguments give equal scores.

        Raises
        ------
        DataError, CalibrationError
            The candidate cannot be measured, which the search takes as its result and goes on.
        FppError
            Any other fault, which is the rig's and ends the search.
        """
        ...

    def close(self) -> None:
        """Close the rig. Called once, also after `measure` has failed."""
        ...
