"""optuna's samplers, asked for points and told what came of them, in rounds of fixed size."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import optuna
from optuna.exceptions import ExperimentalWarning
from optuna.trial import TrialState

from fpplab.optimisation.candidate_runner import CandidateRunner
from fpplab.optimisation.objectives import MeasuredCandidate
from fpplab.optimisation.space import Parameter, Point

MAX_REFUSED_PER_POINT = 50
"""Points refused in a row, for each of a round, after which the sampler is said to find no more."""


@contextmanager
def quiet_optuna() -> Iterator[None]:
    """Optuna keeps its remarks to itself."""
    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExperimentalWarning)
            yield
    finally:
        optuna.logging.set_verbosity(before)


def make_optuna_study(runner: CandidateRunner, sampler: Any) -> Any:
    """An optuna study in memory: what it forgets, the journal answers again."""
    return optuna.create_study(directions=["minimize"] * len(runner.space.study.objectives), sampler=sampler)


def enqueue_points(study: Any, runner: CandidateRunner, points: Sequence[Point]) -> None:
    """Have these asked first."""
    for point in points:
        named = zip(runner.space.parameters, point, strict=True)
        study.enqueue_trial({p.name: int(v) if p.is_integer else v for p, v in named})


def measure_round(study: Any, runner: CandidateRunner, size: int) -> list[MeasuredCandidate]:
    """`size` points that can be shown, asked together, measured, and told in the order asked.

    What is refused is told as failed, and another asked in its place; empty when there is no other.
    """
    asked: list[tuple[Any, Point]] = []
    for _ in range(MAX_REFUSED_PER_POINT * size):
        trial = study.ask()
        point = tuple(_suggested(trial, parameter) for parameter in runner.space.parameters)
        if runner.is_feasible(point):
            asked.append((trial, point))
        else:
            study.tell(trial, state=TrialState.FAIL)
        if len(asked) == size:
            break
    trials = runner.measure([point for _, point in asked])
    for (trial, _), found in zip(asked, trials, strict=True):
        if found.measured:
            for limit, broken in runner.ranking.violations(found).items():
                trial.set_constraint(limit, broken)
            study.tell(trial, runner.ranking.values(found))
        else:
            study.tell(trial, state=TrialState.FAIL)
    return trials


def _suggested(trial: Any, parameter: Parameter) -> float:
    if parameter.is_integer:
        return float(trial.suggest_int(parameter.name, int(parameter.lower), int(parameter.upper)))
    value = trial.suggest_float(
        parameter.name, parameter.lower, parameter.upper, log=parameter.is_logarithmic
    )
    return parameter.rounded(value)
