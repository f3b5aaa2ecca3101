"""Coordinate search: the best of all moves along one parameter, and of two kinds of moves along several.

The two are: phase steps are exchanged between fringe sets; and all stripe counts are stretched together, so
that the ratio from set to set, at which fringe orders begin to fail, grows equally everywhere.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import permutations
from typing import Annotated, Literal

from pydantic import Field

from fpplab.optimisation.candidate import MeasuredCandidate, Point
from fpplab.optimisation.candidate_runner import CandidateRunner
from fpplab.optimisation.ranking import Rank
from fpplab.optimisation.search_method import SearchMethod
from fpplab.optimisation.space import Parameter


class Coordinate(SearchMethod):
    """Moves along one parameter at a time, of a length that is halved down to `finest` when none improves."""

    kind: Literal["coordinate"] = "coordinate"
    """Name of the method."""
    first: Annotated[float, Field(gt=0, le=1)] = 0.25
    """Length of the first moves, as a share of a parameter's range."""
    finest: Annotated[float, Field(gt=0, le=1)] = 0.01
    """Length of the last moves, as a share of a parameter's range."""

    def search(self, runner: CandidateRunner) -> str:
        return coordinate_search(runner, self)


def coordinate_search(
    runner: CandidateRunner,
    settings: Coordinate,
    begin: MeasuredCandidate | None = None,
    parameter_indices: Sequence[int] | None = None,
    rank: Callable[[MeasuredCandidate], Rank] | None = None,
) -> str:
    current, rank = begin or runner.start, rank or runner.ranking.rank
    places = range(len(runner.space.parameters)) if parameter_indices is None else parameter_indices
    length = settings.first
    while True:
        points = list(dict.fromkeys(_moves_along_parameters(runner, current.point, places, length)))
        trials = runner.measure(points)
        best = min([current, *trials], key=rank)
        if rank(best) < rank(current):
            further = runner.measure(list(_double_move(runner, current.point, best.point)))
            current = min([best, *further], key=rank)
            runner.epoch("move", [*trials, *further])
            continue
        runner.epoch("poll", trials)
        if length <= settings.finest and not any(
            _moves_by_several(runner.space.parameters[i], length) for i in places
        ):
            return "no move is better"
        length /= 2


def _moves_by_several(parameter: Parameter, length: float) -> bool:
    return parameter.is_integer and _integer_move(parameter, length) > 1


def _integer_move(parameter: Parameter, length: float) -> int:
    return max(1, round(length * (parameter.upper - parameter.lower)))


def _moves_along_parameters(
    runner: CandidateRunner, point: Point, places: Sequence[int], length: float
) -> Iterator[Point]:
    parameters = runner.space.parameters
    for i in places:
        for sign in (-1, 1):
            value = _move_value(parameters[i], point[i], sign * length)
            if value is not None:
                yield _changed(point, {i: value})
    counts = [i for i in places if parameters[i].name.startswith("steps")]
    for i, j in permutations(counts, 2):
        fewer, more = point[i] - 1, point[j] + 1
        if parameters[i].contains(fewer) and parameters[j].contains(more):
            yield _changed(point, {i: fewer, j: more})
    stripes = [i for i in places if parameters[i].name.startswith("stripes")]
    if len(stripes) > 1:
        for sign in (-1, 1):
            shares = [sign * length * (k + 1) / len(stripes) for k in range(len(stripes))]
            moved = [_move_value(parameters[i], point[i], s) for i, s in zip(stripes, shares, strict=True)]
            yield _changed(point, {i: m for i, m in zip(stripes, moved, strict=True) if m is not None})


def _changed(point: Point, values: dict[int, float]) -> Point:
    return tuple(values.get(i, value) for i, value in enumerate(point))


def _move_value(parameter: Parameter, value: float, length: float) -> float | None:
    """Move a value by a share of its range; None where nothing in the range lies there."""
    if parameter.is_integer:
        moved = value + _integer_move(parameter, abs(length)) * (1 if length > 0 else -1)
        return moved if parameter.contains(moved) else None
    share = parameter.fraction(value) + length
    moved = parameter.value_at(min(max(share, 0.0), 1.0))  # the end of the range is tried too
    return moved if moved != value else None


def _double_move(runner: CandidateRunner, start: Point, end: Point) -> Iterator[Point]:
    further = []
    for parameter, a, b in zip(runner.space.parameters, start, end, strict=True):
        if parameter.is_integer:
            value = 2 * b - a
            inside = parameter.contains(value)
        else:
            share = 2 * parameter.fraction(b) - parameter.fraction(a)
            inside = 0.0 <= share <= 1.0
            value = parameter.value_at(share) if inside else b
        if not inside:
            return
        further.append(value if a != b else a)
    yield tuple(further)
