"""Turns on a rig: a watcher releases it, commands share it, and what a dead process held is free."""

import multiprocessing
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fpplab.core.errors import DeviceError
from fpplab.devices import rig_lock
from fpplab.devices.rig_lock import using_rig, watching_rig

HOLDING = """
import sys, time
from fpplab.devices.rig_lock import using_rig, watching_rig
with {lock}(sys.argv[1]) as turn:
    {do}
    print("has it", flush=True)
    time.sleep(60)
"""


@contextmanager
def waiting(rig: Path, lock: str = "using_rig", do: str = "pass") -> Iterator[subprocess.Popen[str]]:
    """Another process that wants the rig, and has it once it prints that."""
    code = HOLDING.format(lock=lock, do=do)
    with subprocess.Popen(
        [sys.executable, "-c", code, str(rig)], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@contextmanager
def holding(rig: Path, lock: str = "using_rig", do: str = "pass") -> Iterator[subprocess.Popen[str]]:
    """Another process that has the rig."""
    with waiting(rig, lock, do) as process:
        need_it(process)
        yield process


def need_it(process: subprocess.Popen[str]) -> None:
    assert process.stdout is not None
    assert process.stdout.readline() == "has it\n"


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    return tmp_path / "rig_x.yaml"


def test_a_watcher_lets_go_and_goes_on(rig: Path) -> None:
    with watching_rig(rig) as turn:
        assert turn.take()
        assert not turn.is_requested()
        with waiting(rig) as process:
            deadline = time.monotonic() + 20
            while not turn.is_requested() and time.monotonic() < deadline:
                time.sleep(0.01)
            assert turn.is_mine  # nobody takes it away before it is let go
            turn.yield_rig()
            need_it(process)
            assert f"process {process.pid} " in turn.requested_by()
            assert not turn.take()
        assert turn.take()


def test_commands_share_a_rig(rig: Path) -> None:
    """Nothing changes between them: the drivers refuse what is open elsewhere."""
    with holding(rig), using_rig(rig), using_rig(rig):
        pass


def test_there_is_one_watcher(rig: Path) -> None:
    with holding(rig, "watching_rig", "assert turn.take()") as process:
        words = f"process {process.pid} .* watches it already"
        with pytest.raises(DeviceError, match=words), watching_rig(rig):
            pass
        with watching_rig(rig.with_name("rig_y.yaml")) as turn:
            assert turn.take()


def test_what_a_killed_watcher_held_is_free(rig: Path) -> None:
    with holding(rig, "watching_rig", "assert turn.take()") as process:
        process.kill()
        process.wait()
        with using_rig(rig):
            pass
        with watching_rig(rig) as turn:
            assert turn.take()


def test_a_watcher_that_does_not_let_go_is_named(rig: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig_lock, "TURN_TIMEOUT_S", 0.2)
    with holding(rig, "watching_rig", "assert turn.take()") as process:
        words = f"process {process.pid} .* has not released"
        with pytest.raises(DeviceError, match=words), using_rig(rig):
            pass


def test_what_a_watcher_opens_itself_needs_no_turn(rig: Path) -> None:
    with watching_rig(rig) as turn:
        assert turn.take()
        with using_rig(rig):
            assert not turn.is_requested()


@pytest.mark.whole
def test_a_stream_of_commands_does_not_starve_the_one_that_waits(rig: Path) -> None:
    """The watcher takes the rig again at once, over and over; the command gets it all the same."""
    let_go = 0
    process = multiprocessing.get_context("spawn").Process(target=_use, args=(str(rig),))
    with watching_rig(rig) as turn:
        process.start()
        deadline = time.monotonic() + 30
        while process.exitcode is None and time.monotonic() < deadline:
            if turn.is_requested():
                turn.yield_rig()
                let_go += 1
            turn.take()
            time.sleep(0.001)
    process.join(1)
    assert process.exitcode == 0
    assert let_go


def _use(rig: str) -> None:
    with using_rig(Path(rig)):
        time.sleep(0.05)
