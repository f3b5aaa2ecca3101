"""From scores to what a study asks for: figures over artefacts and seeds, limits kept or not, and a rank.

What is measured once per artefact and seed is averaged over both. A plan whose fringe orders fail is not
forgiven by the mean: its distances count all of its points, and beyond the study's limit it is not wanted.
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
"""The violation of a candidate of which nothing could be measured, in place of its share."""


@dataclass(frozen=True)
class CandidateFigures:
    """What a candidate came to: means over artefacts and seeds.

    smcd_spread_um: standard deviation over the seeds of the mean over artefacts, None with one seed.
    worst_smcd_um: of the worst seed. worst_artefact_um: of the worst artefact. wrong_orders, outliers,
    completeness: shares.
    """

    surface_smcd_um: float
    smcd_spread_um: float | None
    worst_smcd_um: float
    worst_artefact_um: float
    surface_rms_um: float
    smcd_um: float
    smcd_floor_um: float
    completeness: float
    wrong_orders: float
    outliers: float
    images: int
    seconds: float

    @classmethod
    def of(cls, scores: Sequence[Score]) -> CandidateFigures:
        """Of every artefact with every seed."""

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
    """Mean surface SMCD over the artefacts in µm, by seed."""
    return _means(scores, "seed")


def _means(scores: Sequence[Score], key: str) -> Mapping[Any, float]:
    """Mean surface SMCD by seed, or by artefact."""
    grouped = defaultdict(list)
    for score in scores:
        grouped[getattr(score, key)].append(score.surface_smcd_um)
    return {name: float(np.mean(values)) for name, values in grouped.items()}


@dataclass(frozen=True)
class MeasuredCandidate:
    """A candidate that was measured, or why it could not be.

    refused: why no rig of the study can show it. failed: why nothing came of measuring it.
    """

    point: Point
    candidate: Candidate
    scores: tuple[Score, ...] = ()
    refused: str | None = None
    failed: str | None = None

    @cached_property
    def figures(self) -> CandidateFigures:
        """What it came to; only where it was measured."""
        return CandidateFigures.of(self.scores)

    @property
    def measured(self) -> bool:
        """Whether there are figures."""
        return self.refused is None and self.failed is None

    def summary(self) -> dict[str, Any]:
        """For a machine to read."""
        known = asdict(self.candidate)
        known["fringes"] = list(known["fringes"])
        return {
            **known,
            **(asdict(self.figures) if self.measured else {"failed": self.refused or self.failed}),
        }


Rank = tuple[float, tuple[float, ...], float]
"""By how much limits are broken, the objectives, the mean distance: less is better, in this order."""


@dataclass(frozen=True)
class CandidateRanking:
    """What a study makes of trials, given what its start came to."""

    study: Study
    start: CandidateFigures

    def violations(self, trial: MeasuredCandidate) -> dict[str, float]:
        """By how much each limit is broken, 0 or less where it is kept; shares, and relative excesses.

        What the start itself has of wrong orders is no fault of a plan that has no more.
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
        """By how much limits are broken in all, 0 where all are kept."""
        return sum(max(excess, 0.0) for excess in self.violations(trial).values())

    def values(self, trial: MeasuredCandidate) -> tuple[float, ...]:
        """The study's objectives, each the less the better."""
        if not trial.measured:
            return (math.inf,) * len(self.study.objectives)
        found = trial.figures
        return tuple(
            -found.completeness if n == "completeness" else getattr(found, n) for n in self.study.objectives
        )

    def rank(self, trial: MeasuredCandidate) -> Rank:
        """Feasible before infeasible, then by objectives, then by the mean distance."""
        distance = trial.figures.surface_smcd_um if trial.measured else math.inf
        return self.violation(trial), self.values(trial), distance

    def rank_by_distance(self, trial: MeasuredCandidate) -> Rank:
        """Feasible before infeasible, then by the mean distance alone, whatever the objectives."""
        violation, _, distance = self.rank(trial)
        return violation, (distance,), distance

    def is_acceptable(self, trial: MeasuredCandidate) -> bool:
        """Whether it keeps every limit."""
        return self.violation(trial) == 0.0

    def front(self, trials: Sequence[MeasuredCandidate]) -> list[MeasuredCandidate]:
        """Those that keep every limit and that no other is better than in everything, by the last objective.

        Of several with the same figures the first.
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
