"""Keys of a terminal become orders; the terminal is left as it was."""

from __future__ import annotations

import os
import pty
import sys
import termios
import time
from collections.abc import Iterator
from queue import SimpleQueue

import pytest

from fpplab.live.keys import terminal_keys
from fpplab.live.orders import Order


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A terminal as stdin; gives the end at which one types."""
    typed, read = pty.openpty()
    with os.fdopen(read, "r") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield typed
    os.close(typed)


def test_keys_become_orders(terminal: int) -> None:
    orders: SimpleQueue[Order] = SimpleQueue()
    before = termios.tcgetattr(sys.stdin.fileno())
    with terminal_keys(orders) as there:
        assert there
        os.write(terminal, b"a+z\n<q")
        deadline = time.monotonic() + 10
        while orders.qsize() < 4 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert [orders.get_nowait() for _ in range(4)] == [
        Order.ADVICE,
        Order.LONGER,
        Order.LESS_GAIN,
        Order.QUIT,
    ]
    assert orders.empty()
    assert termios.tcgetattr(sys.stdin.fileno()) == before


def test_without_a_terminal_there_are_no_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        with terminal_keys(SimpleQueue()) as there:
            assert not there
