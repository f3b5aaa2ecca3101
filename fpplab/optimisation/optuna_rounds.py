"""Rounds of candidates proposed by an optuna sampler, shared by the methods that use optuna."""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import optuna
from optuna.exceptions import ExperimentalWarning
from optuna.trial import TrialState

from fpplab.optimisation.candidate import Point
from fpplab.optimisation.candidate_runner import CandidateRunner
from fpplab.optimisation.figures import MeasuredCandidate
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


def make_optuna_study(runner: CandidateRunner, sampler: Any) -> Any:
    """Make an optuna study in memory; the journal makes it unnecessary to store it."""
    return optuna.create_study(
        directions=["minimize"] * len(runner.space.problem.objectives), sampler=sampler
    )


def enqueue_points(study: Any, runner: CandidateRunner, points: Sequence[Point]) -> None:
    for point in points:
        named = zip(runner.space.parameters, point, strict=True)
        study.enqueue_trial({p.name: int(v) if p.is_integer else v for p, v in named})


def measure_round(study: Any, runner: CandidateRunner, size: int) -> list[MeasuredCandidate]:
    """Ask the sampler for points, measure them together, and tell it the results in the order asked."""
    # A point that the rig or the study does not allow is reported as failed, and another one is asked for.
    asked: list[tuple[Any, Point]] = []
    for _ in range(50 * size):  # chosen: then the sampler counts as exhausted
        trial = study.ask()
        point = tuple(_suggest_value(trial, parameter) for parameter in runner.space.parameters)
        if runner.is_feasible(point):
            asked.append((trial, point))
        else:
            study.tell(trial, state=TrialState.FAIL)
        if len(asked) == size:
            break
    trials = runner.measure([point for _, point in asked])
    for (trial, _), measured in zip(asked, trials, strict=True):
        if measured.measured:
            for limit, broken in runner.ranking.violations(measured).items():
                trial.set_constraint(limit, broken)
            study.tell(trial, runner.ranking.values(measured))
        else:
            study.tell(trial, state=TrialState.FAIL)
    return trials


def _suggest_value(optuna_trial: Any, parameter: Parameter) -> float:
    if parameter.is_integer:
        return float(optuna_trial.suggest_int(parameter.name, int(parameter.lower), int(parameter.upper)))
    value = optuna_trial.suggest_float(
        parameter.name, parameter.lower, parameter.upper, log=parameter.is_logarithmic
    )
    return parameter.rounded(value)
