"""Gradient descent by finite differences, as in the paper, for comparison.

Real parameters go down the slope by a fixed rate; whole ones by 1 towards whichever neighbour is lower. It
stops when the objective has not come down by `gain` for `patience` epochs: 1 µm and five in the paper.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from fpplab.optimisation.candidate_runner import CandidateRunner
from fpplab.optimisation.objectives import MeasuredCandidate
from fpplab.optimisation.space import Parameter, Point
from fpplab.optimisation.study import Gradient

PENALTY = 10.0
"""Loss, in the start's, of breaking a limit by as much as the limit is."""
LONGEST = 0.1
"""Share of a parameter's range that one step goes at most: the slope of a penalty is as good as a wall."""
HALVINGS = 5


def descend(lab: CandidateRunner, settings: Gradient) -> str:
    """Go down from the start; returns why it ended. Raises `Spent`."""
    here = lab.start
    lowest = [_objective(lab, here)]
    while True:
        around = _around(lab, here.point, settings)
        trials = lab.measure([point for pair in around for point in pair])
        pairs = list(zip(trials[::2], trials[1::2], strict=True))
        moves = [
            _move(lab, parameter, here, pair, settings, i)
            for i, (parameter, pair) in enumerate(zip(lab.space.parameters, pairs, strict=True))
        ]
        if not any(moves):
            lab.epoch("slope", trials)
            return "no parameter goes down"
        gone = _go(lab, here.point, moves)
        if gone is None:
            lab.epoch("slope", trials)
            return "the way down leads to what cannot be shown or measured"
        here = gone
        lab.epoch("step", [*trials, here])
        lowest.append(min(lowest[-1], _objective(lab, here)))
        if len(lowest) > settings.patience and lowest[-1 - settings.patience] - lowest[-1] < settings.gain:
            return f"not down by {settings.gain:g} for {settings.patience} epochs"


def _objective(lab: CandidateRunner, trial: MeasuredCandidate) -> float:
    """The objective; of a plan that breaks a limit with its penalty, in the objective's own unit."""
    value, own = lab.judge.values(trial)[0], abs(lab.judge.values(lab.start)[0])
    return value + PENALTY * own * lab.judge.violation(trial)


def _around(lab: CandidateRunner, point: Point, settings: Gradient) -> list[tuple[Point, Point]]:
    """For each parameter a point below and one above, the point itself where its range ends."""
    pairs = []
    for i, parameter in enumerate(lab.space.parameters):
        beside = []
        for sign in (-1, 1):
            value = _beside(parameter, point[i], sign * settings.difference, sign)
            beside.append((*point[:i], value, *point[i + 1 :]) if parameter.holds(value) else point)
        pairs.append((beside[0], beside[1]))
    return pairs


def _beside(parameter: Parameter, value: float, share: float, whole: int) -> float:
    if parameter.whole:
        return value + whole
    return parameter.at(min(max(parameter.share(value) + share, 0.0), 1.0))


def _move(
    lab: CandidateRunner,
    parameter: Parameter,
    here: MeasuredCandidate,
    pair: tuple[MeasuredCandidate, MeasuredCandidate],
    settings: Gradient,
    i: int,
) -> float:
    """How far to go along parameter `i`: a share of its range, or 1 for a whole one; 0 to stay."""
    known = [trial for trial in pair if trial.measured]
    if parameter.whole:
        best = min([here, *known], key=lambda trial: _objective(lab, trial))
        return best.point[i] - here.point[i]
    # Where one side cannot be measured the slope is that of the other.
    low, high = (trial if trial.measured else here for trial in pair)
    width = parameter.share(high.point[i]) - parameter.share(low.point[i])
    if width == 0:
        return 0.0
    own = abs(lab.judge.values(lab.start)[0])
    slope = (_objective(lab, high) - _objective(lab, low)) / own / width
    down = min(max(-settings.rate * slope, -LONGEST), LONGEST)
    share = parameter.share(here.point[i])
    return min(max(share + down, 0.0), 1.0) - share


def _go(lab: CandidateRunner, point: Point, moves: Sequence[float]) -> MeasuredCandidate | None:
    """The first that can be measured of the whole step, half of it, and so on."""
    for halving in range(HALVINGS):
        gone = lab.measure([_moved(lab, point, moves, 0.5**halving)])[0]
        if gone.measured:
            return gone
    return None


def _moved(lab: CandidateRunner, point: Point, moves: Sequence[float], length: float) -> Point:
    return tuple(
        value + math.trunc(length * move)
        if parameter.whole
        else parameter.at(parameter.share(value) + length * move)
        for parameter, value, move in zip(lab.space.parameters, point, moves, strict=True)
    )
