"""The viewer as commands use it: a measurement is never slowed, stopped or outlived by it.

What is to be shown goes through a queue and a thread to a process that draws it (`fpplab.viewer.process`).
Where the process is too slow, images are left out; where it fails or is closed, that is logged once and
nothing more is shown. The process ends with this one, however this one ends.
"""

from __future__ import annotations

import json
import logging
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Self, TypeVar, TypeVarTuple

import psutil

from fpplab.core.progress import ignore
from fpplab.viewer.channel import WAITING, Opening, write_message
from fpplab.viewer.outbox import MOST_WAITING, Message, Outbox
from fpplab.viewer.server import OWN_GROUP, Shown
from fpplab.viewer.view import CommandView

FINISH_S = 120.0
"""Longest time in s in which what waits is drawn and the recording written when the work is done: a second,
unless the computer has much else to do."""

QUIET_S = 10.0
"""Time in s without any work of the process after which it is not waited for: it hangs."""

HURRY_S = 3.0
"""Longest time in s where what waits is left out."""

log = logging.getLogger("fpplab")
V = TypeVar("V", bound=CommandView)
Arguments = TypeVarTuple("Arguments")


class Viewer(Generic[V]):
    """Shows one view; starts when there is something to show, and is used in a `with` block.

    No method raises, and none but `wait` and `close` waits.
    """

    def __init__(
        self,
        view: type[V],
        shown: Shown | None = "anywhere",
        keep: Path | None = None,
        announce: Callable[[str], object] = ignore,
        complete: bool = False,
        most_waiting: int = MOST_WAITING,
    ) -> None:
        self.where = ""
        self.fault: str | None = None
        opening = Opening(view, shown, keep.absolute() if keep else None)
        self._opening = opening if shown or keep else None
        self._announce = announce
        self._outbox = Outbox(most_waiting, waits=complete)
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
        """Show something that may be left out where there is too much."""
        self._add(Message((method, args), droppable=True))

    def _add(self, message: Message) -> None:
        if self._start():
            self._outbox.add(message)

    @property
    def runs(self) -> bool:
        """Whether what is given is shown anywhere."""
        return self._opening is not None and self.fault is None and not self._closing

    def _start(self) -> bool:
        """Start what shows it, if anything is shown and nothing was before; tell whether it is."""
        if not self.runs:
            return False
        if self._thread is None:
            self._thread = threading.Thread(target=self._send, name="viewer", daemon=True)
            self._thread.start()
        return True

    def wait_open(self) -> None:
        """Wait until its address or window is there, or it has failed; nothing need have been shown yet."""
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
        with suppress(KeyboardInterrupt):  # Ctrl-C may come as soon as the first word is out
            self._add(Message(WAITING))
            self._outbox.end()
            self._thread.join()
            self._drawn.wait()
            if self.fault is None:
                announce(self.where)
                self._closed.wait()

    def close(self, hurry: bool = False) -> None:
        """End the process; what waits is shown and the recording finished first. May be called again."""
        self._closing = True
        self._outbox.end(discard=hurry)
        sent = self._thread is None or self._waited_for(_joined(self._thread), hurry)
        process = self._process
        if process is None or process.stdout is None or process.stdout.closed:
            return
        assert process.stdin is not None
        if sent:
            with suppress(OSError):
                process.stdin.close()
        if not (sent and self._waited_for(_ended(process), hurry)):
            process.kill()
            process.wait()
            log.warning("the viewer did not end by itself and was ended; its recording is not complete")
        if self._listener is not None:
            self._listener.join()
        process.stdout.close()
        if self._outbox.dropped:
            log.info("%d images came too fast to be shown", self._outbox.dropped)

    def _waited_for(self, done: Callable[[float], bool], hurry: bool) -> bool:
        """Wait until something is done, for as long as the process works on it; tell whether it is."""
        most, used = HURRY_S if hurry else FINISH_S, self._processor_time()
        deadline = time.monotonic() + most
        while not done(min(QUIET_S, most)):
            now = self._processor_time()
            if now <= used or time.monotonic() > deadline:
                return False
            used = now
        return True

    def _processor_time(self) -> float:
        """Seconds that the process and those it has started have worked."""
        if self._process is None:
            return 0.0
        with suppress(psutil.Error):
            drawing = psutil.Process(self._process.pid)
            times = [one.cpu_times() for one in (drawing, *drawing.children(recursive=True))]
            return float(sum(one.user + one.system for one in times))
        return 0.0

    def _send(self) -> None:
        """Start the process, and write to it until the end is said; runs in a thread."""
        command = [sys.executable, "-m", "fpplab.viewer.process"]
        try:
            self._process = process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, process_group=OWN_GROUP, bufsize=0
            )
            assert process.stdin is not None
            self._listener = threading.Thread(target=self._listen, args=(process,), daemon=True)
            self._listener.start()
            write_message(process.stdin, self._opening)  # type: ignore[arg-type]
            self._opened.wait()
            if not self.where:
                return
            self._announce(self.where)
            while (message := self._outbox.take()) is not None:
                write_message(process.stdin, message.content)  # type: ignore[arg-type]
        except OSError as error:
            if self._listener is not None:
                self._listener.join(HURRY_S)  # the process may have said why
            self._fail(f"its process ended: {error}")
        except Exception as error:  # noqa: BLE001 - whatever it is, the measurement goes on
            self._fail(" ".join(str(error).split()) or type(error).__name__)

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        """Take what the process says, until it ends; runs in a thread."""
        assert process.stdout is not None
        for line in process.stdout:
            words: dict[str, Any] = json.loads(line)
            if "where" in words:
                self.where = str(words["where"])
                self._opened.set()
            if "fault" in words:
                self._fail(str(words["fault"]))
            if "waiting" in words:
                self._closed.clear()  # a page that was closed before may be opened again
                self._drawn.set()
            if "closed" in words:
                self._closed.set()
        if not self._closing:
            self._fail("its process ended")
        for event in (self._opened, self._drawn, self._closed):
            event.set()

    def _fail(self, why: str) -> None:
        """Note a fault, and log the first."""
        if self.fault is None:
            self.fault = why
            self._outbox.end(discard=True)
            log.warning("the viewer is switched off: %s", why)


def _joined(thread: threading.Thread) -> Callable[[float], bool]:
    """Waits for a thread for some seconds, and tells whether it has ended."""

    def joined(seconds: float) -> bool:
        thread.join(seconds)
        return not thread.is_alive()

    return joined


def _ended(process: subprocess.Popen[bytes]) -> Callable[[float], bool]:
    """Waits for a process for some seconds, and tells whether it has ended."""

    def ended(seconds: float) -> bool:
        with suppress(subprocess.TimeoutExpired):
            process.wait(seconds)
        return process.returncode is not None

    return ended
