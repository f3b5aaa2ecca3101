"""Processes that measure candidates, for the benchmark of searches: on one core each, or killed once."""

import os
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numba
import psutil

from fpplab.cli import console
from fpplab.optimisation.candidate import Candidate, Evaluator, Score
from fpplab.optimisation.scheduling import DaskWorkers, EvaluatorFactory, Task
from fpplab.optimisation.storage import ScoresOrReason
from fpplab.patterns.fringe_sets import FringeSet

WARM = 6
"""Measurements until both workers have rendered what they need."""


@dataclass(frozen=True)
class OnOneCore:
    """Opens a rig in a process that measures on one core, which no other has claimed."""

    factory: EvaluatorFactory  # opens the rig
    claims: Path  # folder in which cores are claimed

    def __call__(self) -> Evaluator:
        """Open the rig, on a core of its own."""
        numba.set_num_threads(1)
        if hasattr(os, "sched_setaffinity"):  # elsewhere a process cannot be held to a core
            cores = sorted(os.sched_getaffinity(0))
            own = next(core for core in cores if _claimed(self.claims / f"{core}"))
            os.sched_setaffinity(0, {own})  # of this thread, and of all that it will start
        return self.factory()


def _claimed(path: Path) -> bool:
    """Whether this is the first to ask for it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        path.touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


@dataclass(frozen=True)
class KilledOnce:
    """Opens a rig of which one process is killed while it measures."""

    factory: EvaluatorFactory  # opens the rig
    died: Path  # file that remembers the kill

    def __call__(self) -> Evaluator:
        """Open the rig."""
        return _Mortal(self.factory(), self.died)


@dataclass(frozen=True)
class _Mortal:
    evaluator: Evaluator
    died: Path

    def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
        scores = self.evaluator.measure(candidate, seed)
        if _claimed(self.died):
            psutil.Process().kill()
        return scores

    def close(self) -> None:
        self.evaluator.close()


def candidates_like(like: Candidate, count: int) -> Iterable[Candidate]:
    """Make candidates with a finest set of their own, so that each is rendered."""
    *coarser, finest = like.fringes
    assert isinstance(finest, FringeSet)
    for k in range(count):
        finer = finest.model_copy(update={"stripes": finest.stripes + k})
        yield replace(like, fringes=(*coarser, finer))


def timed_measurements(
    factory: EvaluatorFactory, workers: int, tasks: Sequence[Task]
) -> tuple[dict[int, ScoresOrReason], float]:
    """Measure candidates and take the time."""
    found: dict[int, ScoresOrReason] = {}
    cluster = DaskWorkers(factory, workers)
    try:
        with console.progress(f"Measuring with {workers}") as report:
            cluster.measure(tasks[:WARM], found.__setitem__)
            begin = time.perf_counter()
            cluster.measure(tasks[WARM:], lambda at, outcome: found.__setitem__(WARM + at, outcome))
            seconds = time.perf_counter() - begin
            report(1.0)
    finally:
        cluster.close()
    return found, seconds
