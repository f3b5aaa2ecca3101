"""The viewer as commands use it: a measurement is never slowed, stopped or outlived by it."""

import json
import logging
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Self, TypeVar, TypeVarTuple

import psutil

from fpplab.core.progress import ignore
from fpplab.viewer.canvas import CommandView
from fpplab.viewer.messages import MAX_QUEUED, WAITING, Message, Opening, Outbox
from fpplab.viewer.server import PROCESS_GROUP, ViewerPlace


@dataclass(frozen=True)
class ViewerTimeouts:
    """How long a command waits for its viewer once its own work is done; all chosen."""

    finish_s: float = 120.0  # to draw the queue and write the recording: 1 s, unless the computer is busy
    idle_s: float = 10.0  # without any processor time used: the viewer hangs
    abort_s: float = 3.0  # instead of `finish_s` where the queue is discarded


log = logging.getLogger("fpplab")
V = TypeVar("V", bound=CommandView)
Arguments = TypeVarTuple("Arguments")


class Viewer(Generic[V]):
    """Shows one view in a `with` block; no method raises, and only `wait`, `wait_open` and `close` wait."""

    def __init__(
        self,
        view: type[V],
        shown: ViewerPlace | None = "anywhere",
        recording: Path | None = None,
        announce: Callable[[str], object] = ignore,
        complete: bool = False,
        max_queued: int = MAX_QUEUED,
    ) -> None:
        self.where = ""
        self.fault: str | None = None
        self.timeouts = ViewerTimeouts()
        opening = Opening(view, shown, recording.absolute() if recording else None)
        self._opening = opening if shown or recording else None
        self._announce = announce
        self._outbox = Outbox(max_queued, waits=complete)
        self._thread: threading.Thread | None = None
        self._listener: threading.Thread | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._closing = False
        self._opened, self._drawn, self._closed = (threading.Event() for _ in range(3))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def show(self, method: Callable[[V, *Arguments], object], *args: *Arguments) -> None:
        """Show something that the view is wrong without."""
        self._add(Message((method, args)))

    def show_one_of_many(self, method: Callable[[V, *Arguments], object], *args: *Arguments) -> None:
        """Show something that may be left out where the viewer is too slow."""
        self._add(Message((method, args), droppable=True))

    def _add(self, message: Message) -> None:
        if self._start():
            self._outbox.add(message)

    @property
    def runs(self) -> bool:
        return self._opening is not None and self.fault is None and not self._closing

    def _start(self) -> bool:
        if not self.runs:
            return False
        if self._thread is None:
            self._thread = threading.Thread(target=self._send, name="viewer", daemon=True)
            self._thread.start()
        return True

    def wait_open(self) -> None:
        """Wait until its page or window is open, or it has failed; starts it if nothing was shown yet."""
        if self._start():
            self._opened.wait()

    @property
    def window_closed(self) -> bool:
        """Whether it was shown in a window, and the operator has closed that."""
        return self.where == "window" and self._closed.is_set()

    def wait(self, announce: Callable[[str], object] = ignore) -> None:
        """Wait until the window or page is closed or Ctrl-C is pressed, if anything is shown."""
        if self._thread is None or self.fault is not None:
            return
        with suppress(KeyboardInterrupt):  # Ctrl-C may come as soon as the address is printed
            self._add(Message(WAITING))
            self._outbox.end()
            self._thread.join()
            self._drawn.wait()
            if self.fault is None:
                announce(self.where)
                self._closed.wait()

    def close(self, abort: bool = False) -> None:
        """End the process once the queue is drawn and the recording written, or with `abort` at once."""
        self._closing = True
        self._outbox.end(discard=abort)
        sent = self._thread is None or self._waited_for(_wait_for_thread(self._thread), abort)
        process = self._process
        if process is None or process.stdout is None or process.stdout.closed:
            return
        assert process.stdin is not None
        if sent:
            with suppress(OSError):
                process.stdin.close()
        if not (sent and self._waited_for(_wait_for_process(process), abort)):
            process.kill()
            process.wait()
            log.warning("the viewer did not end by itself and was ended; its recording is not complete")
        if self._listener is not None:
            self._listener.join()
        process.stdout.close()
        if self._outbox.dropped:
            log.info("%d images came too fast to be shown", self._outbox.dropped)

    def _waited_for(self, done: Callable[[float], bool], abort: bool) -> bool:
        """Wait until something is done, as long as the process uses the processor; return whether it is."""
        timeout_s = self.timeouts.abort_s if abort else self.timeouts.finish_s
        deadline, used_s = time.monotonic() + timeout_s, self._processor_time_s()
        while not done(min(self.timeouts.idle_s, timeout_s)):
            now_s = self._processor_time_s()
            if now_s <= used_s or time.monotonic() > deadline:
                return False
            used_s = now_s
        return True

    def _processor_time_s(self) -> float:
        if self._process is None:
            return 0.0
        with suppress(psutil.Error):
            drawing = psutil.Process(self._process.pid)
            times = [process.cpu_times() for process in (drawing, *drawing.children(recursive=True))]
            return float(sum(used.user + used.system for used in times))
        return 0.0

    def _send(self) -> None:
        """Start the process and write the queue to it until that ends; runs in a thread."""
        command = [sys.executable, "-P", "-m", "fpplab.viewer.process"]
        try:
            self._process = process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, process_group=PROCESS_GROUP
            )
            self._listener = threading.Thread(target=self._listen, args=(process,), daemon=True)
            self._listener.start()
            _send_object(process, self._opening)
            self._opened.wait()
            if not self.where:
                return
            self._announce(self.where)
            while (message := self._outbox.take()) is not None:
                _send_object(process, message.content)
        except OSError as error:
            if self._listener is not None:
                self._listener.join(self.timeouts.abort_s)  # the process may have reported why
            self._fail(f"its process ended: {error}")
        except Exception as error:  # noqa: BLE001 - whatever it is, the measurement goes on
            self._fail(" ".join(str(error).split()) or type(error).__name__)

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        """Read the reports of the process until it ends; runs in a thread."""
        assert process.stdout is not None
        for line in process.stdout:
            report: dict[str, Any] = json.loads(line)
            if "where" in report:
                self.where = str(report["where"])
                self._opened.set()
            if "fault" in report:
                self._fail(str(report["fault"]))
            if "waiting" in report:
                self._closed.clear()  # a page that was closed before may be opened again
                self._drawn.set()
            if "closed" in report:
                self._closed.set()
        if not self._closing:
            self._fail("its process ended")
        for event in (self._opened, self._drawn, self._closed):
            event.set()

    def _fail(self, why: str) -> None:
        if self.fault is None:
            self.fault = why
            self._outbox.end(discard=True)
            log.warning("the viewer is switched off: %s", why)


def _send_object(process: subprocess.Popen[bytes], content: object) -> None:
    """Send an object; protocol 5 writes arrays to the pipe without copying them."""
    assert process.stdin is not None
    pickle.dump(content, process.stdin, protocol=5)
    process.stdin.flush()


def _wait_for_thread(thread: threading.Thread) -> Callable[[float], bool]:
    def joined(seconds: float) -> bool:
        thread.join(seconds)
        return not thread.is_alive()

    return joined


def _wait_for_process(process: subprocess.Popen[bytes]) -> Callable[[float], bool]:
    def ended(seconds: float) -> bool:
        with suppress(subprocess.TimeoutExpired):
            process.wait(seconds)
        return process.returncode is not None

    return ended
