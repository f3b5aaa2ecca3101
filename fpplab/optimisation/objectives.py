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
    """Figures of a candidate: means over artefacts and seeds, unless stated otherwise.

    Attributes
    ----------
    surface_smcd_um : float
        Symmetric mean distance between points and true surface in µm.
    smcd_spread_um : float or None
        Standard deviation over the seeds of its mean over artefacts, in µm; None with one seed.
    worst_smcd_um : float
        The same distance for the worst seed, in µm.
    worst_artefact_um : float
        The same distance for the worst artefact, in µm.
    surface_rms_um : float
        Root mean square distance of the points from the true surface in µm.
    smcd_um : float
        Symmetric mean Chamfer distance between points and sampled surface in µm.
    smcd_floor_um : float
        What a perfect measurement would have for `smcd_um`, in µm.
    completeness : float
        Share of the surface that was measured, 0 … 1.
    wrong_orders : float
        Share of points with a wrong fringe order, 0 … 1.
    outliers : float
        Share of points that the filter removed, 0 … 1.
    images : int
        Images that a measurement takes.
    seconds : float
        Acquisition time of a measurement.
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
        """Average the scores of a candidate.

        Parameters
        ----------
        scores : sequence of Score
            Of every artefact with every seed.

        Returns
        -------
        CandidateFigures
            The means.
        """

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
    """Average the surface SMCD over the artefacts, for each seed.

    Parameters
    ----------
    scores : sequence of Score
        Of every artefact with every seed.

    Returns
    -------
    mapping of int to float
        Mean distance in µm by seed.
    """
    return _means(scores, "seed")


def _means(scores: Sequence[Score], key: str) -> Mapping[Any, float]:
    """Average the surface SMCD by seed, or by artefact."""
    grouped = defaultdict(list)
    for score in scores:
        grouped[getattr(score, key)].append(score.surface_smcd_um)
    return {name: float(np.mean(values)) for name, values in grouped.items()}


@dataclass(frozen=True)
class MeasuredCandidate:
    """A candidate with its scores, or the reason why it has none.

    Attributes
    ----------
    point : Point
        Point of the search space.
    candidate : Candidate
        What the point stands for.
    scores : tuple of Score
        Of every artefact with every seed; empty if not measured.
    refused : str or None
        Why the rig or the study does not allow it.
    failed : str or None
        Why the measurement failed.
    """

    point: Point
    candidate: Candidate
    scores: tuple[Score, ...] = ()
    refused: str | None = None
    failed: str | None = None

    @cached_property
    def figures(self) -> CandidateFigures:
        """Mean figures; only of one that was measured."""
        return CandidateFigures.of(self.scores)

    @property
    def measured(self) -> bool:
        """Whether there are figures."""
        return self.refused is None and self.failed is None

    def summary(self) -> dict[str, Any]:
        """Describe the candidate and its figures.

        Returns
        -------
        dict
            Plain data for JSON.
        """
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
    """How a study compares its candidates.

    Attributes
    ----------
    study : Study
        Limits and objectives.
    start : CandidateFigures
        Figures of the start, to which some limits are relative.
    """

    study: Study
    start: CandidateFigures

    def violations(self, trial: MeasuredCandidate) -> dict[str, float]:
        """Compute by how much each limit is exceeded.

        A share of wrong orders that the start has as well is not counted.

        Parameters
        ----------
        trial : MeasuredCandidate
            The candidate.

        Returns
        -------
        dict of str to float
            Excess by name of the limit, 0 or less where the limit is kept: as a share for shares, else
            relative to
            the limit.
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
        """Add up the excess over all limits.

        Parameters
        ----------
        trial : MeasuredCandidate
            The candidate.

        Returns
        -------
        float
            Total excess, 0 if every limit is kept.
        """
        return sum(max(excess, 0.0) for excess in self.violations(trial).values())

    def values(self, trial: MeasuredCandidate) -> tuple[float, ...]:
        """Compute the study's objectives, signed so that lower is better.

        Parameters
        ----------
        trial : MeasuredCandidate
            The candidate.

        Returns
        -------
        tuple of float
            In the study's order; infinite for a candidate that was not measured.
        """
        if not trial.measured:
            return (math.inf,) * len(self.study.objectives)
        found = trial.figures
        return tuple(
            -found.completeness if n == "completeness" else getattr(found, n) for n in self.study.objectives
        )

    def rank(self, trial: MeasuredCandidate) -> Rank:
        """Compute a sort key: acceptable before others, then by the objectives, then by the mean distance.

        Parameters
        ----------
        trial : MeasuredCandidate
            The candidate.

        Returns
        -------
        Rank
            The lower the better.
        """
        distance = trial.figures.surface_smcd_um if trial.measured else math.inf
        return self.violation(trial), self.values(trial), distance

    def rank_by_distance(self, trial: MeasuredCandidate) -> Rank:
        """Compute a sort key that ignores the objectives: acceptable before others, then the mean distance.

        Parameters
        ----------
        trial : MeasuredCandidate
            The candidate.

        Returns
        -------
        Rank
            The lower the better.
        """
        violation, _, distance = self.rank(trial)
        return violation, (distance,), distance

    def is_acceptable(self, trial: MeasuredCandidate) -> bool:
        """Check whether a candidate keeps every limit.

        Parameters
        ----------
        trial : MeasuredCandidate
            The candidate.

        Returns
        -------
        bool
            Whether no limit is exceeded.
        """
        return self.violation(trial) == 0.0

    def front(self, trials: Sequence[MeasuredCandidate]) -> list[MeasuredCandidate]:
        """Select the Pareto front: acceptable candidates that no other dominates.

        Of several candidates with equal objectives the first is kept.

        Parameters
        ----------
        trials : sequence of MeasuredCandidate
            All candidates.

        Returns
        -------
        list of MeasuredCandidate
            The front, in descending order of the last objective.
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
