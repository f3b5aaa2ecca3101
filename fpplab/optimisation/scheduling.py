"""Distributes measurements to this process, to others on this computer, or to workers of a dask scheduler.

Results come back in any order; the caller sorts them. A measurement whose worker dies is repeated by another.
"""

from __future__ import annotations

import logging
import math
import os
import socket
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import astuple, dataclass
from typing import Any, Protocol

from fpplab.core.errors import CalibrationError, DataError, DeviceError
from fpplab.optimisation.candidate import Candidate, Evaluator, Score
from fpplab.optimisation.storage import ScoresOrReason


@dataclass(frozen=True)
class SchedulingLimits:
    """Limits of a scheduler and of its workers."""

    connect_timeout_s: float = 10.0
    """Time that a scheduler may take to answer, and to have a worker. Chosen."""
    max_worker_deaths: int = 10
    """Workers that may die of one measurement before it is given up. Chosen."""


LIMITS = SchedulingLimits()

WORKER_ENVIRONMENT = {
    "MALLOC_ARENA_MAX": 1,
    "MALLOC_MMAP_THRESHOLD_": 32 << 20,
    "MALLOC_TRIM_THRESHOLD_": 1 << 30,
}
"""Environment of a worker, for glibc: freed memory is kept for the next image, which needs as much again.

dask's own setting returns it to the system after every array, so that pages are mapped again half a million
times in each measurement, which takes a third of its time.
"""

Task = tuple[Candidate, int]
"""A candidate and a seed."""
OutcomeCallback = Callable[[int, ScoresOrReason], None]
"""Called with the index of a task and its outcome."""


class EvaluatorFactory(Protocol):
    """Opens a rig to measure on.

    It is pickled and sent to every worker, which keeps the evaluator open as long as it gets equal factories.
    """

    def __call__(self) -> Evaluator:
        """Open the rig. Called in the worker, before its first measurement."""
        ...

    def __hash__(self) -> int: ...


class Workers(Protocol):
    """Interface of what distributes measurements."""

    def measure(self, tasks: Sequence[Task], on_outcome: OutcomeCallback) -> None:
        """Measure all tasks.

        Parameters
        ----------
        tasks : sequence of Task
            Candidates and seeds.
        on_outcome : OutcomeCallback
            Called in this process as soon as a task is done, in any order.

        Raises
        ------
        FppError
            A fault of the rig.
        """
        ...

    def close(self) -> None:
        """Close rigs and end processes."""
        ...


def measure_outcome(evaluator: Evaluator, candidate: Candidate, seed: int) -> ScoresOrReason:
    """Measure, and turn failures that are the candidate's into a reason; those of the rig are raised."""
    try:
        scores = evaluator.measure(candidate, seed)
    except (DataError, CalibrationError) as error:
        return str(error)
    for score in scores:
        if not all(math.isfinite(v) for v in astuple(score) if not isinstance(v, str)):
            return f"nothing of the {score.artefact} could be measured"
    return scores


class InProcessWorkers:
    """Measures in this process, one task after another."""

    def __init__(self, factory: EvaluatorFactory) -> None:
        self._factory = factory
        self._evaluator: Evaluator | None = None

    def measure(self, tasks: Sequence[Task], on_outcome: OutcomeCallback) -> None:
        """Measure all tasks, as `Workers.measure`."""
        for place, (candidate, seed) in enumerate(tasks):
            if self._evaluator is None:
                self._evaluator = self._factory()
            on_outcome(place, measure_outcome(self._evaluator, candidate, seed))

    def close(self) -> None:
        """Close the rig."""
        if self._evaluator is not None:
            self._evaluator.close()


_opened: dict[EvaluatorFactory, Evaluator] = {}
"""The rig that this worker process has open, by its factory."""


def _measure_on_worker(factory: EvaluatorFactory, candidate: Candidate, seed: int) -> ScoresOrReason:
    if factory not in _opened:
        _close_on_worker()  # one rig at a time: two may have the same devices
        _opened[factory] = factory()
    return measure_outcome(_opened[factory], candidate, seed)


def _close_on_worker() -> None:
    while _opened:
        _, evaluator = _opened.popitem()
        evaluator.close()


class DaskWorkers:
    """Measures on the workers of a `dask` scheduler: an existing one, or processes started here."""

    def __init__(self, factory: EvaluatorFactory, workers: int = 1, address: str | None = None) -> None:
        import dask
        import distributed

        library: Any = distributed
        self._factory = factory
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        with ExitStack() as opening:
            spawned = "distributed.nanny.pre-spawn-environ"  # must be set before the process starts
            settings = {f"{spawned}.{name}": value for name, value in WORKER_ENVIRONMENT.items()}
            settings["distributed.scheduler.allowed-failures"] = LIMITS.max_worker_deaths
            opening.enter_context(dask.config.set(settings))
            where: Any = address or opening.enter_context(_start_processes(library, workers))
            self._client: Any = opening.enter_context(_connect(library, where))
            opening.callback(self._close_rigs)
            if address is not None:
                self._await_workers(address)
            self._stack = opening.pop_all()

    def _await_workers(self, address: str) -> None:
        from distributed import TimeoutError as DaskTimeoutError

        try:
            self._client.wait_for_workers(1, timeout=LIMITS.connect_timeout_s)
        except DaskTimeoutError as error:
            raise DeviceError(
                "scheduler",
                "connect",
                f"'{address}' has no workers",
                f"start some with `dask worker {address}` where fpplab is installed",
            ) from error

    def measure(self, tasks: Sequence[Task], on_outcome: OutcomeCallback) -> None:
        """Measure all tasks, as `Workers.measure`."""
        from distributed import as_completed

        ended: Any = as_completed
        futures = [
            self._client.submit(_measure_on_worker, self._factory, candidate, seed, pure=False)
            for candidate, seed in tasks
        ]
        places = {future.key: place for place, future in enumerate(futures)}
        for future in ended(futures):
            on_outcome(places[future.key], self._result(future))

    def _result(self, future: Any) -> ScoresOrReason:
        from distributed.scheduler import KilledWorker

        try:
            outcome: tuple[Score, ...] | str = future.result()
        except KilledWorker as error:
            raise DeviceError(
                "scheduler",
                "measure",
                f"{LIMITS.max_worker_deaths} workers died of one measurement",
                "check their memory and their logs, and run the same command again",
            ) from error
        return outcome

    def _close_rigs(self) -> None:
        self._client.run(_close_on_worker)

    def close(self) -> None:
        """Close the rigs of all workers, and end the processes started here."""
        self._stack.close()


def _connect(library: Any, where: Any) -> Any:
    """Open a client of a cluster started here, or of the scheduler at an address."""
    try:
        if isinstance(where, str):
            _await_greeting(library.comm, where)
        return library.Client(where, timeout=LIMITS.connect_timeout_s)
    except (OSError, ValueError, ImportError) as error:
        raise DeviceError(
            "scheduler",
            "connect",
            f"nothing answers at '{where}' ({error})",
            "start one with `dask scheduler`, and its workers with `dask worker`",
        ) from error


def _await_greeting(addresses: Any, where: str) -> None:
    """Wait until a scheduler greets: the library's client waits for ever where something else listens."""
    with socket.create_connection(
        addresses.get_address_host_port(where), LIMITS.connect_timeout_s
    ) as connection:
        encrypted = addresses.parse_address(where)[0] != "tcp"  # then the client speaks first
        if not encrypted and not connection.recv(1):
            raise OSError("what listens there is no scheduler")


def _start_processes(library: Any, workers: int) -> Any:
    """Start worker processes on this computer, which share its cores."""
    threads = max(1, (os.cpu_count() or 1) // workers)
    return library.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",
        env={"NUMBA_NUM_THREADS": str(threads)},
    )


def make_workers(factory: EvaluatorFactory, count: int, address: str | None) -> Workers:
    """Choose who measures: this process for one worker, other processes for more, or those of a scheduler."""
    if count == 1 and address is None:
        return InProcessWorkers(factory)
    return DaskWorkers(factory, count, address)
