"""Coordinate search: the best of all moves along one parameter, and of two kinds along several.

Steps are exchanged between sets, and all stripe counts stretched together, so that the ratio from set to set,
at which orders begin to fail, grows everywhere alike.

Moves are as long as `first` of a parameter's range, and half as long whenever none is better. A step taken
once is tried again twice as long, so that long ways are short. Nothing but comparisons is used, which common
random numbers make exact: a limit is as good a guide as a slope.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import permutations

from fpplab.optimisation.candidate_runner import CandidateRunner
from fpplab.optimisation.objectives import MeasuredCandidate, Rank
from fpplab.optimisation.space import Parameter, Point
from fpplab.optimisation.study import Coordinate


def coordinates(
    lab: CandidateRunner,
    settings: Coordinate,
    begin: MeasuredCandidate | None = None,
    free: Sequence[int] | None = None,
    rank: Callable[[MeasuredCandidate], Rank] | None = None,
) -> str:
    """Search along the parameters at places `free`, or all; returns why it ended. Raises `Spent`.

    begin: the start by default. rank: less is better; the study's by default.
    """
    here, rank = begin or lab.start, rank or lab.judge.rank
    places = range(len(lab.space.parameters)) if free is None else free
    length = settings.first
    while True:
        points = list(dict.fromkeys(_moves(lab, here.point, places, length)))
        trials = lab.measure(points)
        best = min([here, *trials], key=rank)
        if rank(best) < rank(here):
            further = lab.measure(list(_further(lab, here.point, best.point)))
            here = min([best, *further], key=rank)
            lab.epoch("move", [*trials, *further])
            continue
        lab.epoch("poll", trials)
        if length <= settings.finest and not any(_longer(lab.space.parameters[i], length) for i in places):
            return "no move is better"
        length /= 2


def _longer(parameter: Parameter, length: float) -> bool:
    """Whether a whole parameter still moves by more than 1."""
    return parameter.whole and _whole(parameter, length) > 1


def _whole(parameter: Parameter, length: float) -> int:
    return max(1, round(length * (parameter.most - parameter.least)))


def _moves(lab: CandidateRunner, point: Point, places: Sequence[int], length: float) -> Iterator[Point]:
    parameters = lab.space.parameters
    for i in places:
        for sign in (-1, 1):
            value = _moved(parameters[i], point[i], sign * length)
            if value is not None:
                yield _changed(point, {i: value})
    counts = [i for i in places if parameters[i].name.startswith("steps")]
    for i, j in permutations(counts, 2):
        less, more = point[i] - 1, point[j] + 1
        if parameters[i].holds(less) and parameters[j].holds(more):
            yield _changed(point, {i: less, j: more})
    stripes = [i for i in places if parameters[i].name.startswith("stripes")]
    if len(stripes) > 1:
        for sign in (-1, 1):
            shares = [sign * length * (k + 1) / len(stripes) for k in range(len(stripes))]
            moved = [_moved(parameters[i], point[i], s) for i, s in zip(stripes, shares, strict=True)]
            yield _changed(point, {i: m for i, m in zip(stripes, moved, strict=True) if m is not None})


def _changed(point: Point, values: dict[int, float]) -> Point:
    return tuple(values.get(i, value) for i, value in enumerate(point))


def _moved(parameter: Parameter, value: float, length: float) -> float | None:
    """The value so far away, None where there is none in the range."""
    if parameter.whole:
        moved = value + _whole(parameter, abs(length)) * (1 if length > 0 else -1)
        return moved if parameter.holds(moved) else None
    share = parameter.share(value) + length
    moved = parameter.at(min(max(share, 0.0), 1.0))  # the end of the range is a place to look at, too
    return moved if moved != value else None


def _further(lab: CandidateRunner, here: Point, there: Point) -> Iterator[Point]:
    """As far again in the direction that was better, where that is in the range."""
    further = []
    for parameter, a, b in zip(lab.space.parameters, here, there, strict=True):
        if parameter.whole:
            value = 2 * b - a
            inside = parameter.holds(value)
        else:
            share = 2 * parameter.share(b) - parameter.share(a)
            inside = 0.0 <= share <= 1.0
            value = parameter.at(share) if inside else b
        if not inside:
            return
        further.append(value if a != b else a)
    yield tuple(further)
