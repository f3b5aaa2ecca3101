"""Rounds of candidates proposed by an optuna sampler, shared by the methods that use optuna."""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
import optuna
from optuna.exceptions import ExperimentalWarning
from optuna.study import StudyDirection
from optuna.trial import TrialState

from fpplab.optimisation.candidate import Candidate, MeasuredCandidate, Point
from fpplab.optimisation.candidate_runner import CandidateRunner
from fpplab.optimisation.space import Parameter


@contextmanager
def quiet_optuna() -> Iterator[None]:
    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExperimentalWarning)
            yield
    finally:
        optuna.logging.set_verbosity(before)


@dataclass
class OptunaRounds:
    """A study in memory, which the journal makes it unnecessary to store, and what it was told."""

    runner: CandidateRunner
    study: Any
    random: np.random.Generator
    told: set[Candidate] = field(default_factory=set)

    @classmethod
    def of(cls, runner: CandidateRunner, sampler: Any) -> Self:
        directions = [StudyDirection.MINIMIZE] * len(runner.space.problem.objectives)
        study = optuna.create_study(directions=directions, sampler=sampler)
        return cls(runner, study, np.random.default_rng(runner.space.problem.seeds[0]))

    def enqueue(self, points: Sequence[Point]) -> None:
        for point in points:
            named = zip(self.runner.space.parameters, point, strict=True)
            self.study.enqueue_trial({p.name: int(v) if p.is_integer else v for p, v in named})

    def measure(self, size: int) -> list[MeasuredCandidate]:
        """Measure as many candidates that are new together, and tell the sampler in the order asked."""
        # Different points are one candidate where they differ in numbers of sets that are not shown.
        asked: dict[Candidate, tuple[Any, Point]] = {}
        for _ in range(10 * size):  # chosen: then the sampler counts as exhausted, and chance draws
            self._ask(asked)
            if len(asked) == size:
                break
        for _ in range(200 * size):  # chosen: some thousands, of which hardly any takes time
            if len(asked) == size:
                break
            point = tuple(p.value_at(self.random.random()) for p in self.runner.space.parameters)
            candidate = self.runner.space.candidate(point)
            if candidate not in asked and not self.runner.measured(candidate):
                self.enqueue([point])
                self._ask(asked)
        trials = self.runner.measure([point for _, point in asked.values()])
        for (trial, _), measured in zip(asked.values(), trials, strict=True):
            self._tell(trial, measured)
        return trials

    def _ask(self, asked: dict[Candidate, tuple[Any, Point]]) -> None:
        """Ask for a point and keep it if it is new; tell at once what is known, and what is not allowed."""
        trial = self.study.ask()
        point = tuple(_suggest_value(trial, parameter) for parameter in self.runner.space.parameters)
        candidate = self.runner.space.candidate(point)
        known = self.runner.measured(candidate)
        if known and candidate not in self.told:
            self._tell(trial, known)
        elif known or candidate in asked or not self.runner.is_feasible(point):
            self.study.tell(trial, state=TrialState.FAIL)
        else:
            asked[candidate] = trial, point

    def _tell(self, trial: Any, measured: MeasuredCandidate) -> None:
        self.told.add(measured.candidate)
        if not measured.measured:
            self.study.tell(trial, state=TrialState.FAIL)
            return
        for limit, broken in self.runner.ranking.violations(measured).items():
            trial.set_constraint(limit, broken)
        self.study.tell(trial, self.runner.ranking.values(measured))


def _suggest_value(optuna_trial: Any, parameter: Parameter) -> float:
    if parameter.is_integer:
        return float(optuna_trial.suggest_int(parameter.name, int(parameter.lower), int(parameter.upper)))
    value = optuna_trial.suggest_float(
        parameter.name, parameter.lower, parameter.upper, log=parameter.is_logarithmic
    )
    return parameter.rounded(value)
