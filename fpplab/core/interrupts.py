"""Ctrl-C, SIGTERM or a closed terminal at any moment: one `KeyboardInterrupt`, and the bench is left safe.

Python raises it wherever the program is, and three of these places lose it. An import leaves half a module,
and libraries make another error of it: there it waits until the import is over. In a callback that Python
calls itself, of a weak reference or before an object is deleted, it is swallowed: there it is raised again.
While everything is being closed a second one would leave a device open: it counts only after some seconds.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from types import FrameType
from typing import Any

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""SIGHUP comes where the terminal, or the connection to it, is gone; Windows has none."""
AGAIN_S = 0.02
"""After which time an interruption that came at a bad moment is tried again."""
CLOSING_S = 3.0
"""For which time after an interruption others are ignored, while devices are closed."""
CANCELLED = 130
"""Exit code."""

_interrupted_s: list[float] = []
"""When this process was interrupted, by the monotonic clock."""


def watch_signals() -> None:
    """Have these signals raise `KeyboardInterrupt`, once and where it is not lost."""
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # a background job does not hear Ctrl-C
            signal.signal(number, _interrupt)
    signal.signal(signal.SIGALRM, _interrupt)
    sys.unraisablehook = _unraisable


def leave_at_once() -> None:
    """Have these signals end the process at once: everything is closed, and its answer given."""
    signal.setitimer(signal.ITIMER_REAL, 0)
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda *_: os._exit(CANCELLED))


def comes_of(error: BaseException | None, kind: type[BaseException]) -> bool:
    """Tell whether an error is what something made of another one, such as of an interruption.

    Parameters
    ----------
    error : BaseException or None
        The error.
    kind : type
        Class of the other one.

    Returns
    -------
    bool
        Whether one of that class was being handled when it was raised, or it is one itself.
    """
    while error is not None:
        if isinstance(error, kind):
            return True
        error = error.__cause__ or error.__context__
    return False


def _interrupt(number: int, frame: FrameType | None) -> None:
    now_s = time.monotonic()
    if number != signal.SIGALRM and _interrupted_s and now_s - _interrupted_s[-1] < CLOSING_S:
        return
    _interrupted_s.append(now_s)
    if _is_importing(frame):
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
        return
    raise KeyboardInterrupt


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_globals.get("__name__") == "importlib._bootstrap":
            return True
        frame = frame.f_back
    return False


def _unraisable(swallowed: Any) -> None:
    if issubclass(swallowed.exc_type, KeyboardInterrupt):
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
    else:
        sys.__unraisablehook__(swallowed)
