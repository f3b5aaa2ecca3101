"""The operator's keys: single characters of a terminal, read while the set-up runs."""

import _thread
import os
import select
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from fpplab.core.system import system_module
from fpplab.setup.live.orders import BY_KEY, Orders

termios, tty = system_module("termios"), system_module("tty")  # None on Windows

POLL_S = 0.1  # time in s after which the thread that reads keys checks whether it is to end (chosen)
PREFIXES = "\x00\xe0"  # what Windows puts before the code of a key that is no character, such as an arrow
CTRL_C = "\x03"


@contextmanager
def terminal_keys(orders: Orders) -> Iterator[bool]:
    """Read keys from the terminal, without Enter and without echo; Ctrl-C keeps its meaning."""
    if not sys.stdin.isatty():
        yield False
        return
    with _by_windows() if termios is None else _by_terminal(sys.stdin.fileno()) as typed:
        done = threading.Event()
        reader = threading.Thread(target=_read, args=(typed, orders, done), daemon=True)
        try:
            reader.start()
            yield True
        finally:
            done.set()
            reader.join()


def _read(typed: Callable[[], str | None], orders: Orders, done: threading.Event) -> None:
    """Pass orders on; `typed` waits for `POLL_S` and returns what was typed, None after the last key."""
    while not done.is_set() and (characters := typed()) is not None:
        for character in characters:
            if character in BY_KEY:
                orders.put(BY_KEY[character])


@contextmanager
def _by_terminal(handle: int) -> Iterator[Callable[[], str | None]]:
    def typed() -> str | None:
        ready, _, _ = select.select([handle], [], [], POLL_S)
        if not ready:
            return ""
        return os.read(handle, 64).decode(errors="replace") or None  # nothing: the terminal was closed

    before = termios.tcgetattr(handle)
    tty.setcbreak(handle)
    try:
        yield typed
    finally:
        termios.tcsetattr(handle, termios.TCSADRAIN, before)


@contextmanager
def _by_windows() -> Iterator[Callable[[], str | None]]:
    """The console returns keys one by one and without echo in its normal mode."""
    import msvcrt

    windows: Any = msvcrt  # its types exist on Windows alone
    pause = threading.Event()

    def typed() -> str | None:
        if not windows.kbhit():
            pause.wait(POLL_S)
            return ""
        character: str = windows.getwch()
        if character in PREFIXES:
            windows.getwch()
            return ""
        if character == CTRL_C:  # pressed just while a key was read, when it is a key like others
            _thread.interrupt_main()
        return character

    yield typed
