"""From scores to the figures, limits and objectives of a study, and to an order of candidates.

What is measured once per artefact and seed is averaged over both. Wrong fringe orders are not hidden by the
mean: the distances count all points, and a plan with more of them than the study's limit is not accepted.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fpplab.optimisation.candidate import Candidate, Score
from fpplab.optimisation.space import Point
from fpplab.optimisation.study import Study

UNMEASURED = 1e6
"""Violation of a candidate that could not be measured."""


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
        """Average the scores of a candidate."""

        def mean(name: str) -> float:
            return float(np.mean([getattr(score, name) for score in scores]))

        seeds, artefacts = (list(_means(scores, key).values()) for key in ("seed", "artefact"))
        return cls(
            surface_smcd_um=mean("surface_smcd_um"),
            smcd_spread_um=float(np.std(seeds, ddof=1)) if len(seeds) > 1 else None,
            worst_smcd_um=max(seeds),
            worst_artefact_um=max(artefacts),
            surface_rms_um=mean("surface_rms_um"),
            smcd_um=mean("smcd_um"),
            smcd_floor_um=mean("smcd_floor_um"),
            completeness=mean("completeness"),
            wrong_orders=mean("wrong_orders"),
            outliers=mean("outliers"),
            images=scores[0].images,
            seconds=mean("seconds"),
        )


def seed_means(scores: Sequence[Score]) -> Mapping[int, float]:
    """Average the surface SMCD over the artefacts, for each seed."""
    return _means(scores, "seed")


def _means(scores: Sequence[Score], key: str) -> Mapping[Any, float]:
    """Average the surface SMCD by seed, or by artefact."""
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
        """Mean figures; only of one that was measured."""
        return CandidateFigures.of(self.scores)

    @property
    def measured(self) -> bool:
        """Whether there are figures."""
        return self.refused is None and self.failed is None

    def summary(self) -> dict[str, Any]:
        """Describe the candidate and its figures."""
        known = asdict(self.candidate)
        known["fringes"] = list(known["fringes"])
        return {
            **known,
            **(asdict(self.figures) if self.measured else {"failed": self.refused or self.failed}),
        }


Rank = tuple[float, tuple[float, ...], float]
"""Violation of limits, objectives, mean distance: compared in this order, the lower the better."""


@dataclass(frozen=True)
class CandidateRanking:
    """How a study compares its candidates."""

    study: Study  # limits and objectives
    start: CandidateFigures  # figures of the start, to which some limits are relative

    def violations(self, trial: MeasuredCandidate) -> dict[str, float]:
        """Compute by how much each limit is exceeded.

        A share of wrong orders that the start has as well is not counted.
        """
        if not trial.measured:
            return {"measured": UNMEASURED}
        limits, found = self.study.constraints, trial.figures
        broken = {
            "wrong_orders": found.wrong_orders - max(limits.wrong_orders, self.start.wrong_orders),
            "completeness": limits.completeness_of_start * self.start.completeness - found.completeness,
        }
        if limits.seconds is not None:
            broken["seconds"] = found.seconds / limits.seconds - 1.0
        if limits.smcd_of_start is not None:
            most = limits.smcd_of_start * self.start.surface_smcd_um
            broken["surface_smcd_um"] = found.surface_smcd_um / most - 1.0
        return broken

    def violation(self, trial: MeasuredCandidate) -> float:
        """Add up the excess over all limits."""
        return sum(max(excess, 0.0) for excess in self.violations(trial).values())

    def values(self, trial: MeasuredCandidate) -> tuple[float, ...]:
        """Compute the study's objectives, signed so that lower is better."""
        if not trial.measured:
            return (math.inf,) * len(self.study.objectives)
        found = trial.figures
        return tuple(
            -found.completeness if n == "completeness" else getattr(found, n) for n in self.study.objectives
        )

    def rank(self, trial: MeasuredCandidate) -> Rank:
        """Compute a sort key: acceptable before others, then by the objectives, then by the mean distance."""
        distance = trial.figures.surface_smcd_um if trial.measured else math.inf
        return self.violation(trial), self.values(trial), distance

    def rank_by_distance(self, trial: MeasuredCandidate) -> Rank:
        """Compute a sort key without the objectives: acceptable first, then by mean distance."""
        violation, _, distance = self.rank(trial)
        return violation, (distance,), distance

    def is_acceptable(self, trial: MeasuredCandidate) -> bool:
        """Check whether a candidate keeps every limit."""
        return self.violation(trial) == 0.0

    def front(self, trials: Sequence[MeasuredCandidate]) -> list[MeasuredCandidate]:
        """Select the Pareto front: acceptable candidates that no other dominates.

        Of several candidates with equal objectives the first is kept.
        """
        wanted = [trial for trial in trials if self.is_acceptable(trial)]
        values = {trial.candidate: self.values(trial) for trial in wanted}
        kept: dict[tuple[float, ...], MeasuredCandidate] = {}
        for trial in wanted:
            own = values[trial.candidate]
            if not any(_dominates(other, own) for other in values.values()):
                kept.setdefault(own, trial)
        return [kept[own] for own in sorted(kept, key=lambda own: own[::-1], reverse=True)]


def _dominates(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    return one != other and all(a <= b for a, b in zip(one, other, strict=True))
