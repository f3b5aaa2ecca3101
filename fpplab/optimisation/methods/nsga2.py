"""NSGA-II (optuna) over all parameters together, which begins near optima of single ones or of a bound."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from fpplab.optimisation.candidate import Candidate, MeasuredCandidate, Point
from fpplab.optimisation.candidate_runner import CandidateRunner
from fpplab.optimisation.methods.coordinate import Coordinate, coordinate_search
from fpplab.optimisation.search_method import SearchMethod
from fpplab.phase.order_risk import axis_precision

SINGLE_SEARCH = Coordinate(first=0.25, finest=0.02)  # of the single-parameter searches at the beginning
REFINEMENT = Coordinate(first=0.08, finest=0.02)
"""Of the continuous parameters of each plan of the front at the end."""


@dataclass(frozen=True)
class BoundLimits:
    """What the bound that noise sets says of candidates, before any is measured."""

    drawn: int = 2000  # candidates that are rated (chosen: some seconds)
    changed: int = 2000  # that differ from the best of those in one or two values each (chosen: as many)
    rounds: int = 10  # in which they are changed (chosen)
    beside: tuple[float, float] = (0.8, 1.3)  # seconds of half of the seeds, as multiples of the quickest
    # that measures as well as the start (chosen)
    end_share: float = 0.7  # chance that a value is an end of its range, where optima often are (chosen)
    noise: float = 0.02  # of a grey level at the start's exposure, as a share of the modulation (chosen)
    wrong_order_chance: float = 1e-4  # beyond which a candidate is left out (chosen: outliers outweigh noise)


BOUND = BoundLimits()


class Nsga2(SearchMethod):
    """NSGA-II over all parameters together.

    It begins with the results of single-parameter searches; where exposures or bits are searched, with the
    plans whose noise has the lowest bound for their seconds.
    """

    kind: Literal["nsga2"] = "nsga2"
    """Name of the method."""
    population: Annotated[int, Field(ge=4)] = 24
    """Candidates of a generation."""

    several_objectives: ClassVar[bool] = True
    max_unchanged: ClassVar[int] = 3
    """Generations without a change of the front after which evolution ends. Chosen."""

    def search(self, runner: CandidateRunner) -> str:
        # Imported here because optuna is slow to import, and studies are read without searching.
        import optuna

        from fpplab.optimisation.optuna_rounds import OptunaRounds, quiet_optuna

        first = _search_for_seed_points(runner, self.population)
        with quiet_optuna():
            seed = runner.space.problem.seeds[0]
            sampler = optuna.samplers.NSGAIISampler(population_size=self.population, seed=seed)
            rounds = OptunaRounds.of(runner, sampler)
            rounds.enqueue(first)
            runner.epoch("seeds", rounds.measure(max(len(first), self.population)))
            unchanged, front = 0, runner.front
            while unchanged < self.max_unchanged:
                runner.epoch("generation", rounds.measure(self.population))
                unchanged = unchanged + 1 if runner.front == front else 0
                front = runner.front
        _refine_front(runner)
        return f"the front did not change for {self.max_unchanged} generations, and was refined"


def _refine_front(runner: CandidateRunner) -> None:
    """Refine the continuous parameters of each plan of the front, which evolution finds only roughly."""
    # Then measure every plan of the front with one image more and one less in each set, until none is new.
    continuous = [i for i, parameter in enumerate(runner.space.parameters) if not parameter.is_integer]
    for trial in runner.front if continuous else ():
        coordinate_search(runner, REFINEMENT, trial, continuous, runner.ranking.rank_by_distance)
    asked_before: set[Point] = set()
    while asked := [
        point
        for point in dict.fromkeys(p for trial in runner.front for p in _step_neighbours(runner, trial.point))
        if point not in asked_before and runner.is_feasible(point)
    ]:
        asked_before.update(asked)
        runner.epoch("neighbours", runner.measure(asked))


def _step_neighbours(runner: CandidateRunner, point: Point) -> Iterator[Point]:
    for i, parameter in enumerate(runner.space.parameters):
        for value in (point[i] - 1, point[i] + 1):
            if parameter.field == "steps" and parameter.contains(value):
                yield (*point[:i], value, *point[i + 1 :])


def _search_for_seed_points(runner: CandidateRunner, count: int) -> list[Point]:
    space = runner.space
    others = [space.with_alternative(k) for k in range(1, len(space.arrangements))]
    phases, stripes, geometry = (space.of_group(group) for group in ("steps", "stripes", "geometry"))
    if space.of_group("light"):  # at the start's exposure, plans of many images grow far from the front
        return [runner.start.point, *others, *_points_by_the_bound(runner, count - 1 - len(others))]
    grown = _grow_phase_plan(runner, runner.start.point, phases)
    begin = runner.start if space.refusal(runner.start.candidate) is None or not grown else grown[-1]
    best, singles = begin.point, [runner.start.point, *others, *(trial.point for trial in grown)]
    for places in (stripes, geometry):
        if places:
            coordinate_search(runner, SINGLE_SEARCH, begin, places, runner.ranking.rank_by_distance)
            nearest = min(
                (t for t in runner.trials if _differs_only_in(t, begin, places)),
                key=runner.ranking.rank_by_distance,
            )
            best = tuple(nearest.point[i] if i in places else value for i, value in enumerate(best))
            singles.append(nearest.point)
    if best != begin.point:
        singles += [trial.point for trial in _grow_phase_plan(runner, best, phases)]
    return list(dict.fromkeys(point for point in singles if runner.is_feasible(point)))


_Rated = tuple[float, float, Point]  # seconds, bound of the noise in px, and the point


def _points_by_the_bound(runner: CandidateRunner, count: int) -> list[Point]:
    """Points that have the lowest bound of noise for their seconds, up to those of the start."""
    space, random = runner.space, np.random.default_rng(runner.space.problem.seeds[0])
    drawn = space.of_group("steps", "stripes", "codes", "light")

    def varied(point: Point, places: NDArray[np.bool_]) -> Point:
        share = random.random(len(point))
        share = np.where(random.random(len(share)) < BOUND.end_share, np.rint(share), share)
        return tuple(
            parameter.value_at(float(share[i])) if places[i] else point[i]
            for i, parameter in enumerate(space.parameters)
        )

    may_vary = np.isin(np.arange(len(space.parameters)), drawn)
    rated = _rated(runner, [varied(space.start, may_vary) for _ in range(BOUND.drawn)])
    latest = runner.start.candidate.seconds(space.limits.dead_time_s)
    front = _least_noise(rated, latest)
    for _ in range(BOUND.rounds if front else 0):
        changed = []
        for k in random.integers(0, len(front), BOUND.changed // BOUND.rounds):
            chosen = random.choice(drawn, min(2, len(drawn)), replace=False)
            changed.append(varied(front[k][2], np.isin(np.arange(len(space.parameters)), chosen)))
        front = _least_noise([*front, *_rated(runner, changed)], latest)
    equal_s = _quickest_as_good(runner, front)
    beside = [each for each in front if BOUND.beside[0] <= each[0] / equal_s <= BOUND.beside[1]]
    return list(dict.fromkeys([*_spread(front, count - count // 2), *_spread(beside, count // 2)]))


def _quickest_as_good(runner: CandidateRunner, front: Sequence[_Rated]) -> float:
    """Seconds of the quickest of these that measures as well as the start, by bisection."""
    # The bound knows noise alone, so that its own answer is too quick.
    ranking, low, high, trials = runner.ranking, 0, len(front), list[MeasuredCandidate]()
    while low < high:
        middle = (low + high) // 2
        trials += runner.measure([front[middle][2]])
        if ranking.rank_by_distance(trials[-1]) <= ranking.rank_by_distance(runner.start):
            high = middle
        else:
            low = middle + 1
    if trials:
        runner.epoch("bisection", trials)
    return front[low][0] if low < len(front) else runner.start.figures.seconds


def _rated(runner: CandidateRunner, points: Sequence[Point]) -> list[_Rated]:
    space, rated = runner.space, list[_Rated]()
    for point in dict.fromkeys(points):
        candidate = space.candidate(point)
        if space.refusal(candidate) is None and (bound := _noise_bound(runner, candidate)) < np.inf:
            rated.append((candidate.seconds(space.limits.dead_time_s), bound, point))
    return rated


def _least_noise(rated: Sequence[_Rated], latest_s: float) -> list[_Rated]:
    """Those of which no quicker one has as little noise, the quickest first."""
    front: list[_Rated] = []
    for each in sorted(rated):
        if each[0] <= latest_s and (not front or each[1] < front[-1][1]):
            front.append(each)
    return front


def _spread(rated: Sequence[_Rated], count: int) -> list[Point]:
    at = np.unique(np.linspace(0, len(rated) - 1, min(count, len(rated))).round().astype(int))
    return [rated[k][2] for k in at]


def _noise_bound(runner: CandidateRunner, candidate: Candidate) -> float:
    """Bound of the noise of photons and of patterns' rounding in px; infinite where it makes orders fail."""
    problem, size = runner.space.problem, runner.space.limits.size
    plan = candidate.plan(problem.start)
    axis = candidate.fringes[0].coded_axis or plan.axes[0]
    photons = BOUND.noise**2 * problem.start.exposure_s / candidate.exposure_s
    noise = float(np.sqrt(photons + (2.0 / (2**candidate.pattern_bits - 1)) ** 2 / 12.0))
    spread, chance = axis_precision(plan, axis, size, noise)
    return spread if chance is None or chance <= BOUND.wrong_order_chance else np.inf


def _differs_only_in(
    candidate: MeasuredCandidate, begin: MeasuredCandidate, parameter_indices: Sequence[int]
) -> bool:
    pairs = zip(candidate.point, begin.point, strict=True)
    return all(a == b for i, (a, b) in enumerate(pairs) if i not in parameter_indices)


def _grow_phase_plan(runner: CandidateRunner, point: Point, places: Sequence[int]) -> list[MeasuredCandidate]:
    """Build phase plans from the fewest images up, adding each image to the set where it helps most."""
    parameters = runner.space.parameters
    steps = [i for i in places if parameters[i].name.startswith("steps")]
    if not steps:
        return []
    fewest_images = tuple(parameters[i].lower if i in steps else value for i, value in enumerate(point))
    path, asked = [], [fewest_images]
    while asked := [p for p in asked if runner.is_feasible(p)]:
        trials = runner.measure(asked)
        path.append(min(trials, key=runner.ranking.rank_by_distance))
        runner.epoch("growth", trials)
        current = path[-1].point
        if path[-1].candidate.images >= runner.start.candidate.images:
            break
        asked = [
            (*current[:i], current[i] + 1, *current[i + 1 :])
            for i in steps
            if parameters[i].contains(current[i] + 1)
        ]
    return path
