"""Gradient descent by finite differences, as in the paper, for comparison."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from fpplab.optimisation.candidate import MeasuredCandidate, Point
from fpplab.optimisation.candidate_runner import CandidateRunner
from fpplab.optimisation.search_method import SearchMethod
from fpplab.optimisation.space import Parameter


@dataclass(frozen=True)
class GradientLimits:
    """What the paper does not state of its descent."""

    penalty: float = 10.0  # for a violation of 1, as a multiple of the start's objective (chosen)
    max_step: float = 0.1  # share of a parameter's range (chosen: the slope of the penalty is steep)
    halvings: int = 5  # lengths of a step that are tried, each half of the one before (chosen)


LIMITS = GradientLimits()


class Gradient(SearchMethod):
    """Gradient descent by finite differences, for comparison with the paper."""

    kind: Literal["gradient"] = "gradient"
    """Name of the method."""
    rate: Annotated[float, Field(gt=0, le=1)] = 0.05
    """Step as a share of a parameter's range, for a slope of the start's objective per range."""
    difference: Annotated[float, Field(gt=0, le=0.5)] = 0.02
    """Distance to both sides over which the slope is taken, as a share of a parameter's range."""
    gain: Annotated[float, Field(ge=0)] = 1.0
    """Improvement over `patience` epochs, in the objective's own unit, below which the search stops."""
    patience: Annotated[int, Field(ge=1)] = 5
    """Epochs over which the improvement is judged."""

    def search(self, runner: CandidateRunner) -> str:
        current = runner.start
        lowest = [_penalised_objective(runner, current)]
        while True:
            around = _points_around(runner, current.point, self)
            trials = runner.measure([point for pair in around for point in pair])
            pairs = list(zip(trials[::2], trials[1::2], strict=True))
            moves = [
                _step_along_parameter(runner, parameter, current, pair, self, i)
                for i, (parameter, pair) in enumerate(zip(runner.space.parameters, pairs, strict=True))
            ]
            if not any(moves):
                runner.epoch("slope", trials)
                return "no parameter lowers the objective"
            moved = _measure_step(runner, current.point, moves)
            if moved is None:
                runner.epoch("slope", trials)
                return "the next step leads to what cannot be shown or measured"
            current = moved
            runner.epoch("step", [*trials, current])
            lowest.append(min(lowest[-1], _penalised_objective(runner, current)))
            if len(lowest) > self.patience and lowest[-1 - self.patience] - lowest[-1] < self.gain:
                return f"improved by less than {self.gain:g} in {self.patience} epochs"


def _penalised_objective(runner: CandidateRunner, candidate: MeasuredCandidate) -> float:
    value, scale = runner.ranking.values(candidate)[0], abs(runner.ranking.values(runner.start)[0])
    return value + LIMITS.penalty * scale * runner.ranking.violation(candidate)


def _points_around(runner: CandidateRunner, point: Point, settings: Gradient) -> list[tuple[Point, Point]]:
    """Choose a point below and one above along each parameter; the point itself at the end of a range."""
    pairs = []
    for i, parameter in enumerate(runner.space.parameters):
        neighbours = []
        for sign in (-1, 1):
            value = _neighbour(parameter, point[i], sign * settings.difference, sign)
            neighbours.append((*point[:i], value, *point[i + 1 :]) if parameter.contains(value) else point)
        pairs.append((neighbours[0], neighbours[1]))
    return pairs


def _neighbour(parameter: Parameter, value: float, share: float, integer_step: int) -> float:
    if parameter.is_integer:
        return value + integer_step
    return parameter.value_at(min(max(parameter.fraction(value) + share, 0.0), 1.0))


def _step_along_parameter(
    runner: CandidateRunner,
    parameter: Parameter,
    current: MeasuredCandidate,
    pair: tuple[MeasuredCandidate, MeasuredCandidate],
    settings: Gradient,
    i: int,
) -> float:
    """Compute the step along parameter `i`: a share of its range, or -1, 0 or 1 for an integer."""
    measured = [trial for trial in pair if trial.measured]
    if parameter.is_integer:
        best = min([current, *measured], key=lambda trial: _penalised_objective(runner, trial))
        return best.point[i] - current.point[i]
    # Where one side cannot be measured, the slope is taken over the other side alone.
    low, high = (trial if trial.measured else current for trial in pair)
    width = parameter.fraction(high.point[i]) - parameter.fraction(low.point[i])
    if width == 0:
        return 0.0
    scale = abs(runner.ranking.values(runner.start)[0])
    slope = (_penalised_objective(runner, high) - _penalised_objective(runner, low)) / scale / width
    down = min(max(-settings.rate * slope, -LIMITS.max_step), LIMITS.max_step)
    share = parameter.fraction(current.point[i])
    return min(max(share + down, 0.0), 1.0) - share


def _measure_step(runner: CandidateRunner, point: Point, moves: Sequence[float]) -> MeasuredCandidate | None:
    """Measure the whole step, half of it, and so on, until one can be measured; None if none can."""
    for halving in range(LIMITS.halvings):
        moved = runner.measure([_stepped(runner, point, moves, 0.5**halving)])[0]
        if moved.measured:
            return moved
    return None


def _stepped(runner: CandidateRunner, point: Point, moves: Sequence[float], length: float) -> Point:
    return tuple(
        value + math.trunc(length * move)
        if parameter.is_integer
        else parameter.value_at(parameter.fraction(value) + length * move)
        for parameter, value, move in zip(runner.space.parameters, point, moves, strict=True)
    )
