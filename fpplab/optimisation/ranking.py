"""The order of candidates: by the limits of a study first, then by its objectives."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from fpplab.optimisation.candidate import MeasuredCandidate
from fpplab.optimisation.objective import Objective, registered_objectives
from fpplab.optimisation.problem import SearchProblem

Rank = tuple[float, tuple[float, ...], float]
"""Violation of limits, objectives, mean distance: compared in this order, the lower the better."""


@dataclass(frozen=True)
class CandidateRanking:
    """How a study compares its candidates."""

    problem: SearchProblem  # limits and objectives
    start: MeasuredCandidate  # the start, to which some limits are relative

    @cached_property
    def objectives(self) -> tuple[Objective, ...]:
        registered = registered_objectives()
        return tuple(registered[key] for key in self.problem.objectives)

    @cached_property
    def _limited(self) -> tuple[tuple[Objective, float], ...]:
        limits = [
            (objective, getattr(self.problem.constraints, objective.limit.key))
            for objective in registered_objectives().values()
            if objective.limit is not None
        ]
        return tuple((objective, limit) for objective, limit in limits if limit is not None)

    def violations(self, candidate: MeasuredCandidate) -> dict[str, float]:
        # A share of wrong orders that the start has as well is not counted.
        if not candidate.measured:
            return {"measured": 1e6}  # chosen: more than any measured candidate can exceed limits by
        share = max(self.problem.constraints.wrong_orders, self.start.figures.wrong_orders)
        excess = {"wrong_orders": candidate.figures.wrong_orders - share}
        for objective, limit in self._limited:
            value, of_start = objective.value(candidate), objective.value(self.start)
            excess[objective.key] = objective.excess(value, of_start, limit)
        return excess

    def violation(self, trial: MeasuredCandidate) -> float:
        return sum(max(excess, 0.0) for excess in self.violations(trial).values())

    def values(self, candidate: MeasuredCandidate) -> tuple[float, ...]:
        """Compute the objectives, signed so that lower is better."""
        if not candidate.measured:
            return (math.inf,) * len(self.objectives)
        return tuple(
            -objective.value(candidate) if objective.is_maximised else objective.value(candidate)
            for objective in self.objectives
        )

    def objective_values(self, trial: MeasuredCandidate) -> dict[str, float]:
        return {objective.key: objective.value(trial) for objective in self.objectives}

    def rank(self, candidate: MeasuredCandidate) -> Rank:
        """Compute a sort key: acceptable before others, then by the objectives, then by the mean distance."""
        distance = candidate.figures.surface_smcd_um if candidate.measured else math.inf
        return self.violation(candidate), self.values(candidate), distance

    def rank_by_distance(self, candidate: MeasuredCandidate) -> Rank:
        """Compute a sort key without the objectives: acceptable first, then by mean distance."""
        violation, _, distance = self.rank(candidate)
        return violation, (distance,), distance

    def is_acceptable(self, trial: MeasuredCandidate) -> bool:
        return self.violation(trial) == 0.0

    def front(self, trials: Sequence[MeasuredCandidate]) -> list[MeasuredCandidate]:
        """Select the Pareto front: acceptable candidates that no other dominates."""
        # Of several candidates with equal objectives the first is kept.
        acceptable = [trial for trial in trials if self.is_acceptable(trial)]
        values_by_candidate = {trial.candidate: self.values(trial) for trial in acceptable}
        front: dict[tuple[float, ...], MeasuredCandidate] = {}
        for trial in acceptable:
            values = values_by_candidate[trial.candidate]
            if not any(_dominates(other, values) for other in values_by_candidate.values()):
                front.setdefault(values, trial)
        return [front[values] for values in sorted(front, key=lambda values: values[::-1], reverse=True)]


def _dominates(values: tuple[float, ...], others: tuple[float, ...]) -> bool:
    return values != others and all(a <= b for a, b in zip(values, others, strict=True))
