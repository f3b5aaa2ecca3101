"""The queue of a service: one scan at a time, each with a file that says what became of it."""

from __future__ import annotations

import contextlib
import gc
import json
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from fpplab.core import interrupts
from fpplab.core.config import validate
from fpplab.core.confirmation import confirm_in_advance, confirmed_in_advance
from fpplab.core.errors import Cancelled, ConfigError, DataError, FppError
from fpplab.core.extras import missing_extra
from fpplab.core.files import read_bounded, write_text
from fpplab.core.progress import Progress, ignore
from fpplab.core.session_names import JOURNAL, REPORT
from fpplab.core.strict_json import json_value, parse_object
from fpplab.results.observer import Observer
from fpplab.service.limits import LIMITS
from fpplab.service.order import ScanOrder, ScanStatus
from fpplab.service.state import ScanState

if TYPE_CHECKING:
    from fpplab.results.scan import ScanResult
    from fpplab.workflows.instrument import Instrument

RECORDS = ".scans"
"""Folder, in the service's, with a file for each scan."""
MAX_RECORD_BYTES = 16_000_000  # of one of them (chosen): a result is some kilobytes

_log = logging.getLogger(__name__)


class ScanQueue:
    """Orders are accepted and asked for by any thread; `work` carries them out in its own."""

    def __init__(self, bench: Instrument, folder: Path) -> None:
        self._bench, self._folder = bench, folder.resolve()
        self._records = self._folder / RECORDS
        self._waiting: SimpleQueue[tuple[int, ScanOrder]] = SimpleQueue()
        self._active: dict[int, ScanStatus] = {}  # what has not ended; all else is on disk
        self._cancelled: set[int] = set()
        self._lock = threading.Lock()
        self._standing = confirmed_in_advance()
        self._rig_name = bench.rig.source
        self._last = 0
        self.on_change: Callable[[], object] = ignore
        """Called by the thread that works, each time that a scan has changed."""
        self._find_earlier()

    def accept(self, order: ScanOrder) -> ScanStatus:
        with self._lock:
            if len(self._active) >= LIMITS.max_queued:
                raise ConfigError(f"{LIMITS.max_queued} scans wait already; order again when some are done")
            self._last += 1
            status = ScanStatus(id=self._last, ordered_s=time.time(), out=order.out and str(self._out(order)))
            self._store(status, order)
            with contextlib.suppress(OSError):  # Windows keeps it as long as a client reads it
                self._record(self._last - LIMITS.max_records).unlink()
            self._active[status.id] = status
        self._waiting.put((status.id, order))
        return status

    def get(self, number: int) -> ScanStatus | None:
        with self._lock:
            active = self._active.get(number)
        return active or self._recorded(number)

    def latest(self, count: int) -> list[ScanStatus]:
        """List the latest scans, the last one first, without their results."""
        numbers = range(self._last, max(0, self._last - count), -1)
        statuses = (status for n in numbers if (status := self.get(n)) is not None)
        return [status.model_copy(update={"result": None}) for status in statuses]

    def cancel(self, number: int) -> None:
        with self._lock:
            if number in self._active:
                self._cancelled.add(number)

    def work(self) -> None:
        """Carry out orders until interrupted."""
        while True:
            self.work_once(0.5)  # without a time-out, Windows hears no Ctrl-C

    def work_once(self, timeout_s: float) -> None:
        with contextlib.suppress(Empty):
            number, order = self._waiting.get(timeout=timeout_s)
            self._carry_out(number, order)
            if order.report:
                gc.collect()  # its figures refer to themselves, and hold tens of megabytes until then

    def _carry_out(self, number: int, order: ScanOrder) -> None:
        end: dict[str, Any]
        try:
            self.check_cancelled(number)
            result = self._scan(number, order)
            end = {"state": ScanState.FINISHED, "result": result.summary()}
            if result.diagnosis.is_useless:
                end["error"] = _fault_of(result.require_usable)
        except KeyboardInterrupt:
            end = {"state": ScanState.INTERRUPTED}
            raise
        except Exception as error:  # the next scan may be better
            end = {"state": ScanState.CANCELLED if isinstance(error, Cancelled) else ScanState.FAILED}
            end["error"] = _as_fault(error)
            if interrupts.is_caused_by(error, KeyboardInterrupt):
                end = {"state": ScanState.INTERRUPTED}
                raise KeyboardInterrupt from error
        finally:
            with interrupts.held_back():
                self._end(number, order, end)

    def _scan(self, number: int, order: ScanOrder) -> ScanResult:
        folder = Path(order.folder) if order.folder else self._folder
        if order.out is None:
            order = order.model_copy(update={"out": str(self._bench.next_session())})
        out = self._out(order)
        status = self.change(number, state=ScanState.RUNNING, out=str(out))
        self._store(status, order)
        with contextlib.chdir(folder):  # messages and reports call the files what the client calls them
            self._bench.rig.source = order.rig or self._rig_name
            confirm_in_advance({*order.allow, *self._standing})
            return self._bench.run_order(order, Path(str(order.out)), QueueObserver(self, number))

    def change(self, number: int, **fields: Any) -> ScanStatus:
        with self._lock:
            status = self._active[number]
            status = status.model_copy(update={**fields, "version": status.version + 1})
            self._active[number] = status
        self.on_change()
        return status

    def check_cancelled(self, number: int) -> None:
        if number in self._cancelled:
            raise Cancelled("cancelled")

    def _end(self, number: int, order: ScanOrder, end: dict[str, Any]) -> None:
        status = self._active[number].model_copy(update={"stage": None, **end})
        try:
            # As it is read again: numbers and paths as JSON has them.
            status = validate(json.loads(_as_json(status)), ScanStatus, "status")
            self._store(status, order)
        except DataError as error:
            _log.warning("scan %d: its end is not recorded: %s", number, error)
            self.change(number, **dict(status))
            return
        with self._lock:
            del self._active[number]
            self._cancelled.discard(number)
        self.on_change()

    def _out(self, order: ScanOrder) -> Path:
        return Path(order.folder or self._folder) / str(order.out)

    # --- records

    def _record(self, number: int) -> Path:
        return self._records / f"{number:06d}.json"

    def _store(self, status: ScanStatus, order: ScanOrder) -> None:
        text = f'{{"order": {order.model_dump_json()},\n"status": {_as_json(status)}}}\n'
        write_text(self._record(status.id), text)

    def _recorded(self, number: int) -> ScanStatus | None:
        read = self._read(number)
        if read is None or read[0].state.has_ended:
            return read and read[0]
        return read[0].model_copy(update={"state": ScanState.INTERRUPTED})  # by a service that was killed

    def _read(self, number: int) -> tuple[ScanStatus, ScanOrder] | None:
        path = self._record(number)
        try:
            record = parse_object(read_bounded(path, MAX_RECORD_BYTES))
            return validate(record["status"], ScanStatus, path), validate(record["order"], ScanOrder, path)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError) as error:
            raise DataError(f"{path}: is not the record of a scan ({error}); delete it") from error

    def _find_earlier(self) -> None:
        """Go on with what an earlier service has left: without light, which nobody expects now."""
        numbers = sorted(
            int(path.stem) for path in self._records.glob("[0-9]*.json") if path.stem.isdecimal()
        )
        self._last = max(numbers, default=0)
        for number in numbers[: -LIMITS.max_records]:
            self._record(number).unlink(missing_ok=True)
        # Scans are carried out in their order: all before one that has ended have ended.
        for number in reversed(numbers[-LIMITS.max_records :]):
            status, order = self._read(number) or (None, None)
            if status is None or order is None or status.state.has_ended:
                break
            if _has_all_frames(status):
                (Path(str(status.out)) / REPORT).unlink(missing_ok=True)  # which says that all is done
                # Only where a report is still to be drawn may a session have all its frames.
                order = order.model_copy(update={"force": False, "report": True})
                self._active[number] = status.model_copy(update={"state": ScanState.QUEUED})
                self._waiting.put((number, order))


def _has_all_frames(status: ScanStatus) -> bool:
    """Tell whether the frames that a scan ordered are all on disk; older ones are those of another."""
    from fpplab.sessions.session import Session

    if status.out is None or not (Path(status.out) / JOURNAL).is_file():
        return False
    try:
        session = Session.open(Path(status.out))
        return not session.missing() and max(r.host_time_s for r in session.records) >= status.ordered_s
    except FppError:
        return False


def _as_json(status: ScanStatus) -> str:
    return json.dumps(status.model_dump(), default=json_value, allow_nan=False)


def _as_fault(error: Exception) -> dict[str, Any]:
    if missing := missing_extra(error):
        error = missing
    if isinstance(error, FppError):
        return {"error": str(error), "exit_code": error.exit_code, **error.details}
    _log.error("a fault of fpplab itself", exc_info=error)
    return {"error": f"a fault of fpplab itself: {type(error).__name__}: {error}", "exit_code": 1}


def _fault_of(refuse: Callable[[], object]) -> dict[str, Any]:
    try:
        refuse()
    except FppError as error:
        return _as_fault(error)
    return {}


class QueueObserver(Observer):
    """Tells the queue how far a scan is, and ends it once it is cancelled."""

    def __init__(self, queue: ScanQueue, number: int) -> None:
        self._queue, self._number = queue, number
        self._told = 0.0

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        self._told, start = 0.0, time.perf_counter()
        self._queue.change(self._number, stage=name, progress=0.0)
        yield self._progress
        seconds = time.perf_counter() - start
        _log.info("%s: %.3f s", name, seconds, extra={"phase": name, "seconds": seconds})

    def _progress(self, share: float) -> None:
        self._queue.check_cancelled(self._number)
        if share >= self._told + LIMITS.progress_step:
            self._told = share
            self._queue.change(self._number, progress=float(share))

    def message(self, sentence: str) -> None:
        status = self._queue.get(self._number)
        self._queue.change(self._number, messages=(*(status.messages if status else ()), sentence))

    def exposed(self) -> None:
        self._queue.change(self._number, state=ScanState.EXPOSED)

    def result(self, result: object) -> None:
        diagnosis, cloud = getattr(result, "diagnosis", None), getattr(result, "cloud", None)
        if diagnosis is not None:
            self._queue.change(
                self._number,
                state=ScanState.JUDGED,
                verdict=diagnosis.verdict.value,
                sentence=diagnosis.sentence,
                points=len(cloud) if cloud else 0,
            )
