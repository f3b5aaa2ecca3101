"""Who measures: this process, processes beside it, or those of a scheduler on other machines.

The order of what comes back means nothing: whoever asks puts it in the order asked. A measurement whose
worker dies is done again by another.
"""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import astuple, dataclass
from typing import Any, Protocol

from fpplab.core.errors import CalibrationError, DataError, DeviceError
from fpplab.optimisation.candidate import Candidate, Evaluator, Score
from fpplab.optimisation.storage import ScoresOrReason
from fpplab.optimisation.study import Study

CONNECT_TIMEOUT_S = 10.0
"""How long a scheduler may take to answer."""
MAX_WORKER_DEATHS = 10
"""How many workers may die of one measurement before it is given up."""
ALLOCATION = {
    "MALLOC_ARENA_MAX": 1,
    "MALLOC_MMAP_THRESHOLD_": 32 << 20,
    "MALLOC_TRIM_THRESHOLD_": 1 << 30,
}
"""Environment of a worker, for glibc: memory is kept for the next image, which needs as much again.

dask's own setting gives it back after every array, and pages are mapped anew half a million times for
each measurement: a third of its time.
"""

Task = tuple[Candidate, int]
"""A candidate and a seed."""
Done = Callable[[int, ScoresOrReason], None]
"""Told the place of a task and what came of it."""


class EvaluatorFactory(Protocol):
    """Opens a rig to measure on; it is sent to every worker, where it is told from others by its equality."""

    def __call__(self) -> Evaluator: ...

    def __hash__(self) -> int: ...


@dataclass(frozen=True)
class RigEvaluatorFactory:
    """Opens the rig of a study."""

    rig: str
    study: Study

    def __call__(self) -> Evaluator:
        from fpplab.optimisation.measuring import RigEvaluator

        return RigEvaluator(self.rig, self.study)


class Workers(Protocol):
    """Whoever measures."""

    def measure(self, tasks: Sequence[Task], done: Done) -> None:
        """Measure all, telling `done` of each as it is there. Raises the `FppError` of a rig that fails."""
        ...

    def close(self) -> None:
        """Let go of rigs and processes."""
        ...


def measure_outcome(evaluator: Evaluator, candidate: Candidate, seed: int) -> ScoresOrReason:
    """Scores, or why nothing came of measuring: what the candidate is to blame for is no fault of the rig."""
    try:
        scores = evaluator.measure(candidate, seed)
    except (DataError, CalibrationError) as error:
        return str(error)
    for score in scores:
        if not all(math.isfinite(v) for v in astuple(score) if not isinstance(v, str)):
            return f"nothing of the {score.artefact} could be measured"
    return scores


class InProcessWorkers:
    """This process, one measurement after another."""

    def __init__(self, factory: EvaluatorFactory) -> None:
        self._factory = factory
        self._evaluator: Evaluator | None = None

    def measure(self, tasks: Sequence[Task], done: Done) -> None:
        for place, (candidate, seed) in enumerate(tasks):
            if self._evaluator is None:
                self._evaluator = self._factory()
            done(place, measure_outcome(self._evaluator, candidate, seed))

    def close(self) -> None:
        if self._evaluator is not None:
            self._evaluator.close()


_opened: dict[EvaluatorFactory, Evaluator] = {}
"""Rigs that this worker process has open, by who opened them."""


def _measure_there(factory: EvaluatorFactory, candidate: Candidate, seed: int) -> ScoresOrReason:
    if factory not in _opened:
        _close_there()  # one rig at a time: the devices of two may be the same
        _opened[factory] = factory()
    return measure_outcome(_opened[factory], candidate, seed)


def _close_there() -> None:
    while _opened:
        _, evaluator = _opened.popitem()
        evaluator.close()


class DaskWorkers:
    """Workers of a `dask` scheduler: at `address`, or `workers` processes of one's own.

    Raises `DeviceError` when nothing answers at the address.
    """

    def __init__(self, factory: EvaluatorFactory, workers: int = 1, address: str | None = None) -> None:
        import dask
        import distributed

        library: Any = distributed
        self._factory = factory
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        with ExitStack() as opening:
            spawned = "distributed.nanny.pre-spawn-environ"  # what must be there as a process begins
            settings = {f"{spawned}.{name}": value for name, value in ALLOCATION.items()}
            settings["distributed.scheduler.allowed-failures"] = MAX_WORKER_DEATHS
            opening.enter_context(dask.config.set(settings))
            where: Any = address or opening.enter_context(_processes(library, workers))
            try:
                self._client: Any = opening.enter_context(library.Client(where, timeout=CONNECT_TIMEOUT_S))
            except (OSError, ValueError, ImportError) as error:
                raise DeviceError(
                    "scheduler",
                    "connect",
                    f"nothing answers at '{address}' ({error})",
                    "start one with `dask scheduler`, and its workers with `dask worker`",
                ) from error
            opening.callback(self._let_go)
            if address is not None:
                self._await_workers(address)
            self._stack = opening.pop_all()

    def _await_workers(self, address: str) -> None:
        from distributed import TimeoutError as NoneCame

        try:
            self._client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
        except NoneCame as error:
            raise DeviceError(
                "scheduler",
                "connect",
                f"'{address}' has no workers",
                f"start some with `dask worker {address}` where fpplab is installed",
            ) from error

    def measure(self, tasks: Sequence[Task], done: Done) -> None:
        from distributed import as_completed

        ended: Any = as_completed
        futures = [
            self._client.submit(_measure_there, self._factory, candidate, seed, pure=False)
            for candidate, seed in tasks
        ]
        places = {future.key: place for place, future in enumerate(futures)}
        for future in ended(futures):
            done(places[future.key], self._result(future))

    def _result(self, future: Any) -> ScoresOrReason:
        from distributed.scheduler import KilledWorker

        try:
            found: tuple[Score, ...] | str = future.result()
        except KilledWorker as error:
            raise DeviceError(
                "scheduler",
                "measure",
                f"{MAX_WORKER_DEATHS} workers died of one measurement",
                "see to their memory and their logs, and run the same command again",
            ) from error
        return found

    def _let_go(self) -> None:
        self._client.run(_close_there)

    def close(self) -> None:
        self._stack.close()


def _processes(library: Any, workers: int) -> Any:
    """Processes beside this one, which share its cores."""
    threads = max(1, (os.cpu_count() or 1) // workers)
    return library.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",
        env={"NUMBA_NUM_THREADS": str(threads)},
    )


def make_workers(factory: EvaluatorFactory, count: int, address: str | None) -> Workers:
    """This process for one worker, processes beside it for more, or those of the scheduler at an address."""
    if count == 1 and address is None:
        return InProcessWorkers(factory)
    return DaskWorkers(factory, count, address)
