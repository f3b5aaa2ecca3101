"""Candidates of a search, the scores that measuring them gives, and the interface of what measures."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Any, Protocol

import numpy as np

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


@dataclass(frozen=True)
class CandidateFigures:
    """Figures of a candidate: means over artefacts and seeds, unless stated otherwise."""

    surface_smcd_um: float  # symmetric mean distance between points and true surface in µm
    smcd_spread_um: float | None  # standard deviation over the seeds of its mean over artefacts, in µm
    worst_smcd_um: float  # the same distance for the worst seed, in µm
    worst_artefact_um: float  # the same distance for the worst artefact, in µm
    surface_rms_um: float  # root mean square distance of the points from the true surface in µm
    smcd_um: float  # symmetric mean Chamfer distance between points and sampled surface in µm
    smcd_floor_um: float  # what a perfect measurement would have for `smcd_um`, in µm
    completeness: float  # share of the surface that was measured, 0 … 1
    wrong_orders: float  # share of points with a wrong fringe order, 0 … 1
    outliers: float  # share of points that the filter removed, 0 … 1
    images: int  # images that a measurement takes
    seconds: float  # acquisition time of a measurement

    @classmethod
    def of(cls, scores: Sequence[Score]) -> CandidateFigures:
        seeds, artefacts = (list(_mean_scores_by(scores, key).values()) for key in ("seed", "artefact"))
        means = [f.name for f in fields(cls) if f.name != "images" and hasattr(scores[0], f.name)]
        return cls(
            smcd_spread_um=float(np.std(seeds, ddof=1)) if len(seeds) > 1 else None,
            worst_smcd_um=max(seeds),
            worst_artefact_um=max(artefacts),
            images=scores[0].images,
            **{name: float(np.mean([getattr(score, name) for score in scores])) for name in means},
        )


def seed_means(scores: Sequence[Score]) -> Mapping[int, float]:
    return _mean_scores_by(scores, "seed")


def _mean_scores_by(scores: Sequence[Score], key: str) -> Mapping[Any, float]:
    grouped = defaultdict(list)
    for score in scores:
        grouped[getattr(score, key)].append(score.surface_smcd_um)
    return {name: float(np.mean(values)) for name, values in grouped.items()}


@dataclass(frozen=True)
class MeasuredCandidate:
    """A candidate with its scores, or the reason why it has none."""

    point: Point  # point of the search space
    candidate: Candidate  # what the point stands for
    scores: tuple[Score, ...] = ()  # of every artefact with every seed; empty if not measured
    refused: str | None = None  # why the rig or the study does not allow it
    failed: str | None = None  # why the measurement failed

    @cached_property
    def figures(self) -> CandidateFigures:
        return CandidateFigures.of(self.scores)

    @property
    def measured(self) -> bool:
        return self.refused is None and self.failed is None

    def summary(self) -> dict[str, Any]:
        figures = asdict(self.figures) if self.measured else {"failed": self.refused or self.failed}
        return {**candidate_fields(self.candidate), **figures}
