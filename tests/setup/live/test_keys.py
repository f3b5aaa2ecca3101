"""Keys of a terminal become orders; the terminal is left as it was."""

import os
import pty
import sys
import termios
import time
from collections.abc import Callable, Iterator
from queue import SimpleQueue
from types import SimpleNamespace

import pytest

from fpplab.setup.live.keys import terminal_keys
from fpplab.setup.live.orders import Order


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


class Console:
    """What msvcrt gives of the keys typed at a console of Windows."""

    def __init__(self, typed: str) -> None:
        self.left = list(typed)

    def kbhit(self) -> bool:
        return bool(self.left)

    def getwch(self) -> str:
        return self.left.pop(0)


@pytest.fixture
def console(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Console]:
    """Makes this computer one of Windows whose operator has typed something."""

    def typed(keys: str) -> Console:
        there = Console(keys)
        monkeypatch.setattr("fpplab.setup.live.keys.termios", None)
        monkeypatch.setitem(sys.modules, "msvcrt", there)
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
        return there

    return typed


def test_keys_of_a_windows_console_become_orders(console: Callable[[str], Console]) -> None:
    """The arrow to the left is two characters, of which the second is K; with the prefix of others, q."""
    orders: SimpleQueue[Order] = SimpleQueue()
    there = console("a\xe0K\x00q+z<q")
    with terminal_keys(orders) as is_there:
        assert is_there
        deadline = time.monotonic() + 10
        while (there.left or orders.qsize() < 4) and time.monotonic() < deadline:
            time.sleep(0.01)
    found = [orders.get_nowait() for _ in range(4)]
    assert found == [Order.ADVICE, Order.LONGER, Order.LESS_GAIN, Order.QUIT]
    assert orders.empty()


def test_ctrl_c_that_a_windows_console_takes_for_a_key_interrupts(console: Callable[[str], Console]) -> None:
    console("\x03")
    with pytest.raises(KeyboardInterrupt), terminal_keys(SimpleQueue()):
        time.sleep(10)
