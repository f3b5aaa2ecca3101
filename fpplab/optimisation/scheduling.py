"""Distributes measurements to processes or to a dask scheduler's workers; results come back in any order."""

import logging
import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import astuple
from typing import Any, Protocol

from fpplab.core.errors import CalibrationError, DataError, DeviceError
from fpplab.optimisation import cluster
from fpplab.optimisation.candidate import Candidate, Evaluator, Score
from fpplab.optimisation.storage import ScoresOrReason

Task = tuple[Candidate, int]  # a candidate and a seed
OutcomeCallback = Callable[[int, ScoresOrReason], None]  # called with the index of a task and its outcome

EvaluatorFactory = Callable[[], Evaluator]
"""Opens the rig in the process that is to measure, before its first measurement; pickled on the way there."""


class Workers(Protocol):
    """Interface of what distributes measurements."""

    def measure(self, tasks: Sequence[Task], on_outcome: OutcomeCallback) -> None:
        """Measure all tasks; each calls `on_outcome` in this process when done, in any order."""
        ...

    def close(self) -> None: ...


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
        for place, (candidate, seed) in enumerate(tasks):
            if self._evaluator is None:
                self._evaluator = self._factory()
            on_outcome(place, measure_outcome(self._evaluator, candidate, seed))

    def close(self) -> None:
        if self._evaluator is not None:
            self._evaluator.close()


_opened: dict[EvaluatorFactory, Evaluator] = {}  # the rig that this worker process has open, by its factory


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

    def __init__(
        self, factory: EvaluatorFactory, workers: int = 1, scheduler: cluster.Meeting | None = None
    ) -> None:
        self._factory = factory
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        with ExitStack() as opening:
            opening.enter_context(cluster.dask_settings())
            if scheduler is None:
                processes = opening.enter_context(cluster.start_processes(workers))
                self._client: Any = opening.enter_context(processes.get_client())
            else:
                self._client = opening.enter_context(scheduler.client())
            opening.callback(self._client.run, _close_on_worker)
            if scheduler is not None:
                self._await_workers(scheduler.address)
            self._stack = opening.pop_all()

    def _await_workers(self, address: str) -> None:
        from distributed import TimeoutError as DaskTimeoutError

        try:
            self._client.wait_for_workers(1, timeout=cluster.LIMITS.connect_timeout_s)
        except DaskTimeoutError as error:
            raise DeviceError(
                "scheduler",
                "connect",
                f"'{address}' has no workers",
                f"start some with `fpplab cluster --join {address}`",
            ) from error

    def measure(self, tasks: Sequence[Task], on_outcome: OutcomeCallback) -> None:
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
                f"{cluster.LIMITS.max_worker_deaths} workers died of one measurement",
                "check their memory and their logs, and run the same command again",
            ) from error
        return outcome

    def close(self) -> None:
        self._stack.close()


def make_workers(factory: EvaluatorFactory, count: int, scheduler: cluster.Meeting | None) -> Workers:
    if count == 1 and scheduler is None:
        return InProcessWorkers(factory)
    return DaskWorkers(factory, count, scheduler)
