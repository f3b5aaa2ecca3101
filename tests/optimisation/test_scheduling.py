"""Measuring by several processes gives the same results as by one, even if some are killed."""

from __future__ import annotations

import mmap
import os
import socket
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fpplab.core.errors import DeviceError, LimitError
from fpplab.optimisation import cluster
from fpplab.optimisation.candidate import Candidate, Score
from fpplab.optimisation.candidate_runner import BudgetExhausted, CandidateRunner
from fpplab.optimisation.cluster import Meeting, SchedulingLimits
from fpplab.optimisation.scheduling import (
    DaskWorkers,
    EvaluatorFactory,
    InProcessWorkers,
    Task,
    Workers,
    make_workers,
)
from fpplab.optimisation.space import SearchSpace
from fpplab.optimisation.storage import Journal, ScoresOrReason
from fpplab.patterns.fringe_sets import stepped_fringes
from tests.support.searching import LIMITS, Formula, study

TASKS: list[Task] = [
    (Candidate((stepped_fringes("x", 1.0, 3), stepped_fringes("x", 4.0 + k, 3 + k)), 0.02), seed)
    for k in range(4)
    for seed in (1, 2)
]
IMAGES, IMAGE_BYTES = 60, 3_000_000


def measured(workers: Workers, tasks: list[Task]) -> dict[int, ScoresOrReason]:
    found: dict[int, ScoresOrReason] = {}
    workers.measure(tasks, found.__setitem__)
    return found


@pytest.fixture(scope="module")
def pair() -> Iterator[DaskWorkers]:
    workers = DaskWorkers(Formula(noise_um=2.0), workers=2)
    yield workers
    workers.close()


def opening(factory: EvaluatorFactory, pair: DaskWorkers) -> DaskWorkers:
    """The same workers with another rig."""
    other = object.__new__(DaskWorkers)
    other._factory, other._client = factory, pair._client
    return other


def test_one_worker_measures_in_this_process() -> None:
    assert isinstance(make_workers(Formula(), 1, None), InProcessWorkers)


@pytest.mark.whole
def test_two_processes_give_the_same_scores_as_one(pair: DaskWorkers) -> None:
    assert measured(pair, TASKS) == measured(InProcessWorkers(Formula(noise_um=2.0)), TASKS)


@pytest.mark.whole
def test_optimum_and_order_do_not_depend_on_the_number_of_workers(tmp_path: Path, pair: DaskWorkers) -> None:
    wanted, found = study(budget=30), []
    for name, workers in (("one", InProcessWorkers(Formula(noise_um=2.0))), ("two", pair)):
        space = SearchSpace.of(wanted, LIMITS, "study.yaml")
        runner = CandidateRunner(space, workers, Journal(tmp_path / f"{name}.jsonl", wanted, {}))
        with pytest.raises(BudgetExhausted):
            wanted.method.search(runner)
        found.append((runner.best, runner.trials))
    assert found[0] == found[1]


@pytest.mark.whole
def test_measurement_of_a_killed_worker_is_repeated(tmp_path: Path) -> None:
    formula = Formula(dies_once=tmp_path / "died")
    workers = DaskWorkers(formula, workers=2)
    try:
        found = measured(workers, TASKS)
    finally:
        workers.close()
    assert (tmp_path / "died").exists()
    assert found == measured(InProcessWorkers(Formula()), TASKS)


@dataclass(frozen=True)
class Filling:
    """Fills an array as large as an image, again and again, and scores the pages that were mapped for it."""

    def __call__(self) -> Filling:
        return self

    def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
        import resource  # exists on systems with glibc

        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        for _ in range(IMAGES):
            np.ones(IMAGE_BYTES, np.uint8)
        mapped = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
        (score, _) = Formula()().measure(candidate, seed)
        return (replace(score, points=mapped),)

    def close(self) -> None: ...


@pytest.mark.whole
@pytest.mark.skipif(sys.platform != "linux", reason="what glibc does with memory")
def test_worker_memory_is_reused_for_the_next_image(pair: DaskWorkers) -> None:
    (found,) = measured(opening(Filling(), pair), TASKS[:1]).values()
    assert not isinstance(found, str)
    assert found[0].points < IMAGES * IMAGE_BYTES / mmap.PAGESIZE / 10


@dataclass(frozen=True)
class Stuck:
    """A rig that fails."""

    def __call__(self) -> Stuck:
        return self

    def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
        raise LimitError("stage", "move_to", "70 mm was asked for", "the travel is 0 to 60 mm")

    def close(self) -> None: ...


@pytest.mark.whole
def test_rig_fault_is_raised_from_the_worker_process(pair: DaskWorkers) -> None:
    with pytest.raises(LimitError, match="70 mm was asked for"):
        measured(opening(Stuck(), pair), TASKS[:1])


@pytest.mark.whole
def test_workers_load_nothing_of_the_working_directory(pair: DaskWorkers) -> None:
    assert set(pair._client.run(lambda: sys.flags.safe_path).values()) == {True}


@pytest.mark.whole
def test_environment_of_workers_stays_theirs() -> None:
    before = dict(os.environ)
    DaskWorkers(Formula()).close()
    assert dict(os.environ) == before


def test_missing_scheduler_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "LIMITS", SchedulingLimits(connect_timeout_s=0.5))
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    with pytest.raises(DeviceError, match=f"nothing answers at 'tcp://127.0.0.1:{port}'"):
        DaskWorkers(Formula(), scheduler=Meeting.at(f"tcp://127.0.0.1:{port}", None))


@pytest.mark.whole
def test_scheduler_without_workers_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "LIMITS", SchedulingLimits(connect_timeout_s=0.5))
    distributed: Any = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as empty:
        address = empty.scheduler_address
        with pytest.raises(DeviceError, match=f"'{address}' has no workers"):
            DaskWorkers(Formula(), scheduler=Meeting.at(address, None))


@pytest.mark.whole
def test_workers_of_an_existing_scheduler_measure(pair: DaskWorkers) -> None:
    address = pair._client.scheduler.address
    elsewhere = DaskWorkers(Formula(noise_um=2.0), scheduler=Meeting.at(address, None))
    try:
        assert measured(elsewhere, TASKS) == measured(InProcessWorkers(Formula(noise_um=2.0)), TASKS)
    finally:
        elsewhere.close()


def test_listener_that_is_no_scheduler_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "LIMITS", SchedulingLimits(connect_timeout_s=0.5))
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(DeviceError, match=f"nothing answers at '{address}'"):
            DaskWorkers(Formula(), scheduler=Meeting.at(address, None))
