"""NSGA-II through optuna over all parameters together, begun with what single-parameter searches find.

First the single-parameter optima, which a front must contain or dominate: phase counts thinned image by
image from the start; stripes and geometry by coordinate search. Then every phase plan with the stripes and
the geometry found: that alone is most of a front. Then generations, and what is real is settled at last.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import optuna

from fpplab.optimisation.candidate_runner import CandidateRunner
from fpplab.optimisation.methods.asking import enqueue, quiet, round_of, study_of
from fpplab.optimisation.methods.coordinate import coordinates
from fpplab.optimisation.objectives import MeasuredCandidate
from fpplab.optimisation.space import Point
from fpplab.optimisation.study import Coordinate, Nsga2

SINGLES = Coordinate(kind="coordinate", first=0.25, finest=0.02)
POLISH = Coordinate(kind="coordinate", first=0.08, finest=0.02)
STALE = 3
"""Generations without a change of the front after which it ends."""


def pareto(lab: CandidateRunner, settings: Nsga2) -> str:
    """Search until the front stands still; returns why it ended. Raises `Spent`."""
    first = _singles(lab)
    with quiet():
        seed = lab.space.study.seeds[0]
        sampler = optuna.samplers.NSGAIISampler(population_size=settings.population, seed=seed)
        study = study_of(lab, sampler)
        enqueue(study, lab, first)
        lab.epoch("seeds", round_of(study, lab, max(len(first), settings.population)))
        stale, front = 0, lab.front
        while stale < STALE:
            lab.epoch("generation", round_of(study, lab, settings.population))
            stale = stale + 1 if lab.front == front else 0
            front = lab.front
    _polish(lab)
    return f"the front stood still for {STALE} generations, and was polished"


def _polish(lab: CandidateRunner) -> None:
    """Settle what is real of each plan of the front, of which evolution finds the neighbourhood alone.

    Then look at every plan of the front with an image more and one less in each set, until it stands still.
    """
    real = [i for i, parameter in enumerate(lab.space.parameters) if not parameter.whole]
    for trial in lab.front if real else ():
        coordinates(lab, POLISH, trial, real, lab.judge.by_distance)
    looked_at: set[Point] = set()
    while asked := [
        point
        for point in dict.fromkeys(p for trial in lab.front for p in _beside(lab, trial.point))
        if point not in looked_at and lab.admits(point)
    ]:
        looked_at.update(asked)
        lab.epoch("neighbours", lab.measure(asked))


def _beside(lab: CandidateRunner, point: Point) -> Iterator[Point]:
    for i, parameter in enumerate(lab.space.parameters):
        for value in (point[i] - 1, point[i] + 1):
            if parameter.name.startswith("steps") and parameter.holds(value):
                yield (*point[:i], value, *point[i + 1 :])


def _singles(lab: CandidateRunner) -> list[Point]:
    """The start, the single-parameter optima, and phase plans grown at the best stripes and geometry."""
    space = lab.space
    phases, stripes, geometry = (space.of_group(group) for group in ("steps", "stripes", "geometry"))
    grown = _grow(lab, lab.start.point, phases)
    begin = lab.start if space.refusal(lab.start.candidate) is None or not grown else grown[-1]
    best, singles = begin.point, [lab.start.point, *(trial.point for trial in grown)]
    for places in (stripes, geometry):
        if places:
            coordinates(lab, SINGLES, begin, places, lab.judge.by_distance)
            found = min((t for t in lab.trials if _differs(t, begin, places)), key=lab.judge.by_distance)
            best = tuple(found.point[i] if i in places else value for i, value in enumerate(best))
            singles.append(found.point)
    if best != begin.point:
        singles += [trial.point for trial in _grow(lab, best, phases)]
    return list(dict.fromkeys(point for point in singles if lab.admits(point)))


def _differs(trial: MeasuredCandidate, begin: MeasuredCandidate, places: Sequence[int]) -> bool:
    """Whether a trial is `begin` but for the parameters at `places`."""
    pairs = zip(trial.point, begin.point, strict=True)
    return all(a == b for i, (a, b) in enumerate(pairs) if i not in places)


def _grow(lab: CandidateRunner, point: Point, places: Sequence[int]) -> list[MeasuredCandidate]:
    """Phase plans from the fewest images up, each image added to the set where it helps most."""
    parameters = lab.space.parameters
    steps = [i for i in places if parameters[i].name.startswith("steps")]
    if not steps:
        return []
    least = tuple(parameters[i].least if i in steps else value for i, value in enumerate(point))
    path, asked = [], [least]
    while asked := [p for p in asked if lab.admits(p)]:
        trials = lab.measure(asked)
        path.append(min(trials, key=lab.judge.by_distance))
        lab.epoch("growth", trials)
        here = path[-1].point
        if path[-1].candidate.images >= lab.start.candidate.images:
            break
        asked = [(*here[:i], here[i] + 1, *here[i + 1 :]) for i in steps if parameters[i].holds(here[i] + 1)]
    return path
