"""The operator's keys: single characters of a terminal, read while the set-up runs."""

from __future__ import annotations

import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager

from fpplab.live.orders import BY_KEY, Orders

LOOK_S = 0.1
"""How often the thread that reads keys looks whether it is to end, in s."""


@contextmanager
def terminal_keys(orders: Orders) -> Iterator[bool]:
    """Read keys from the terminal, without Enter and without echo; Ctrl-C keeps its meaning.

    Parameters
    ----------
    orders : Orders
        Takes the order of each key that has one.

    Yields
    ------
    bool
        Whether there is a terminal at all.
    """
    if not sys.stdin.isatty():
        yield False
        return
    handle, done = sys.stdin.fileno(), threading.Event()
    before = termios.tcgetattr(handle)
    reader = threading.Thread(target=_read, args=(handle, orders, done), daemon=True)
    tty.setcbreak(handle)
    try:
        reader.start()
        yield True
    finally:
        done.set()
        reader.join()
        termios.tcsetattr(handle, termios.TCSADRAIN, before)


def _read(handle: int, orders: Orders, done: threading.Event) -> None:
    while not done.is_set():
        ready, _, _ = select.select([handle], [], [], LOOK_S)
        if not ready:
            continue
        typed = os.read(handle, 64)
        if not typed:  # the terminal was closed
            return
        for character in typed.decode(errors="replace"):
            if character in BY_KEY:
                orders.put(BY_KEY[character])
