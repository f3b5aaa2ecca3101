"""Ctrl-C, SIGTERM or a closed terminal at any moment: one `KeyboardInterrupt`, and the bench is left safe.

Python raises it wherever the program is, and three of these places lose it. An import leaves half a module,
and libraries make another error of it: there it waits until the import is over. In a callback that Python
calls itself, of a weak reference or before an object is deleted, it is swallowed: there it is raised again.
While everything is being closed one would leave a device open: the first waits until all is closed, and a
second one counts only after some seconds.
"""

import _thread
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
SIGNALS = tuple(getattr(signal, name) for name in NAMES if hasattr(signal, name))
"""SIGHUP comes where the terminal, or the connection to it, is gone; on Windows it is SIGBREAK."""
AGAIN_S = 0.02  # time in s after which an interruption that came at a bad moment is tried again (chosen)
CLOSING_S = 3.0  # time in s in which others are ignored, while devices are closed (chosen)
CANCELLED = 130  # exit code, as shells have it of programs that SIGINT ended: 128 and the signal's number, 2

_interrupted: list[tuple[float, signal.Signals]] = []
"""When this process was interrupted, by the monotonic clock, and by which signal."""
_again: list[signal.Signals] = []  # the signal that is to come again
_sending = threading.Lock()
_held: list[signal.Signals | None] = []
"""For every `held_back` that is entered: the signal that came meanwhile."""


def watch_signals() -> None:
    """Have these signals raise `KeyboardInterrupt`, once and where it is not lost."""
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # a background job does not hear Ctrl-C
            signal.signal(number, _interrupt)
    sys.unraisablehook = _unraisable


@contextmanager
def held_back() -> Iterator[None]:
    """Finish what makes the bench safe, and raise an interruption that comes meanwhile after it."""
    if threading.current_thread() is not threading.main_thread():  # which no signal interrupts
        yield
        return
    _held.append(None)
    try:
        yield
    finally:
        interrupt = _held.pop()
        if interrupt is not None:
            if not _held:
                raise KeyboardInterrupt
            _held[-1] = interrupt


def end_on_next_signal() -> bool:
    """Let the next signal end the process at once; return whether one is waiting already."""
    with _sending:
        waits = bool(_again)
        _again.clear()
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda *_: os._exit(CANCELLED))
    return waits


def is_caused_by(error: BaseException | None, kind: type[BaseException]) -> bool:
    while error is not None:
        if isinstance(error, kind):
            return True
        error = error.__cause__ or error.__context__
    return False


def _interrupt(number: int, frame: FrameType | None) -> None:
    now_s = time.monotonic()
    if number in _again:
        _again.clear()
    elif _interrupted and now_s - _interrupted[-1][0] < CLOSING_S:
        return
    _interrupted.append((now_s, signal.Signals(number)))
    if _held and len(_interrupted) == 1:  # who asks again will not wait for what does not end
        _held[-1] = signal.Signals(number)
        return
    if _is_importing(frame):
        _come_again()
        return
    raise KeyboardInterrupt


def _come_again() -> None:
    """Have the signal come again, from a thread: an alarm would crash pylon's emulated camera."""
    _again[:] = [_interrupted[-1][1] if _interrupted else signal.SIGINT]
    _thread.start_new_thread(_send_again, ())  # without a lock, which the interrupted code may hold


def _send_again() -> None:
    time.sleep(AGAIN_S)
    with _sending:
        for number in _again:
            if hasattr(signal, "pthread_kill"):  # which also ends what the main thread waits for
                signal.pthread_kill(threading.main_thread().ident or 0, number)
            else:
                _thread.interrupt_main(number)


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_globals.get("__name__") == "importlib._bootstrap":
            return True
        frame = frame.f_back
    return False


def _unraisable(swallowed: Any) -> None:
    if issubclass(swallowed.exc_type, KeyboardInterrupt):
        _come_again()
    else:
        sys.__unraisablehook__(swallowed)
