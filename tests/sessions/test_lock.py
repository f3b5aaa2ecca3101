"""One process at a time writes into a session, and a lock dies with its process."""

import errno
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fpplab.core.errors import DataError
from fpplab.sessions.lock import exclusive_write
from fpplab.sessions.session import Session

HOLD = """
import sys, time
from pathlib import Path
from fpplab.sessions.lock import exclusive_write
sys.argv[1:] = ["scan", "--out"]
with exclusive_write(Path(PLACE)):
    print("held", flush=True)
    time.sleep(60)
"""

WRITE = """
import time
from pathlib import Path
import numpy as np
from fpplab.core.errors import DataError
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.sessions.lock import exclusive_write
from fpplab.sessions.session import Session
plan = Plan(fringes=(Sinusoid(axis="x", stripes=1, steps=4),))
print("ready", flush=True)
input()
try:
    with exclusive_write(Path(PLACE)):
        session = Session.create(Path(PLACE), plan, {"name": "rig"}, FORCE)
        for index, (_, _, pattern) in enumerate(plan.steps()):
            image = np.full((4, 5), index, np.uint8)
            session.write(Frame(image, index, CameraSettings(0.01), 0.0, pattern_id=pattern))
        time.sleep(1.0)
    print("written")
except DataError as error:
    print(error)
"""


def started(script: str, place: Path, force: bool = False) -> subprocess.Popen[str]:
    script = script.replace("PLACE", repr(str(place))).replace("FORCE", repr(force))
    return subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


@contextmanager
def holder(place: Path) -> Iterator[subprocess.Popen[str]]:
    process = started(HOLD, place)
    try:
        assert process.stdout
        assert process.stdout.readline() == "held\n"
        yield process
    finally:
        process.kill()
        process.communicate()


def test_the_second_writer_is_told_who_the_first_is(tmp_path: Path) -> None:
    with holder(tmp_path / "part") as process:
        told = rf"part: process {process.pid} on .* \('fpplab scan --out', since .*\) is writing into it"
        with pytest.raises(DataError, match=told), exclusive_write(tmp_path / "part"):
            pass


def test_the_lock_dies_with_its_process(tmp_path: Path) -> None:
    with holder(tmp_path / "part") as process:
        process.send_signal(signal.SIGKILL)
        process.wait()
        with exclusive_write(tmp_path / "part"):
            pass
    assert list(tmp_path.iterdir()) == []


def test_one_process_may_hold_it_twice(tmp_path: Path) -> None:
    inside = tmp_path / "part"
    with exclusive_write(inside):
        with exclusive_write(tmp_path / "other" / ".." / "part"):
            pass
        assert (tmp_path / ".part.lock").is_file()
    assert not (tmp_path / ".part.lock").exists()


def test_folders_made_for_the_lock_alone_do_not_stay(tmp_path: Path) -> None:
    with exclusive_write(tmp_path / "a" / "b" / "part"):
        pass
    assert list(tmp_path.iterdir()) == []
    with exclusive_write(tmp_path / "a" / "b" / "part"):
        (tmp_path / "a" / "note").touch()
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["note"]


def test_a_file_system_that_cannot_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(handle: int, shared: bool = False) -> bool:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fpplab.core.lock.try_lock", refuse)
    with pytest.raises(DataError, match="cannot lock files"), exclusive_write(tmp_path / "part"):
        pass


@pytest.mark.whole
@pytest.mark.parametrize("force", [False, True])
def test_one_of_several_processes_wins(tmp_path: Path, force: bool) -> None:
    place = tmp_path / "part"
    writers = [started(WRITE, place, force) for _ in range(4)]
    for writer in writers:
        assert writer.stdout
        assert writer.stdout.readline() == "ready\n"
    for writer in writers:
        assert writer.stdin
        writer.stdin.write("\n")
        writer.stdin.flush()
    said = [writer.communicate()[0].strip() for writer in writers]
    assert said.count("written") == 1
    assert sum("is writing into it" in words for words in said) == 3
    assert Session.open(place).missing() == []
    assert [path.name for path in tmp_path.iterdir()] == ["part"]
