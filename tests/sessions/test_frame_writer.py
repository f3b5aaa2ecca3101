"""Frames written beside their acquisition: in order, few at a time, and whatever happens to either."""

import os
import signal
import threading
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from fpplab.acquisition.acquire import FrameObserver
from fpplab.core.conventions import Image
from fpplab.core.errors import DataError
from fpplab.core.progress import ignore
from fpplab.core.session_names import FRAMES, JOURNAL
from fpplab.devices import Frame
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.sessions.frame_files import tiff_head
from fpplab.sessions.frame_writer import write_frames
from fpplab.sessions.limits import SESSION_LIMITS
from fpplab.sessions.session import Session
from tests.support.recorded import frame, image_of, in_a_child

PLAN = Plan(fringes=(Sinusoid(axis="x", stripes=1, steps=40),))
DEADLOCK_S = 20.0


@pytest.fixture(autouse=True)
def _quick_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a process has written outlives it, also when it is not on the disk yet."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)


@pytest.fixture
def session(tmp_path: Path) -> Session:
    return Session.create(tmp_path / "session", PLAN)


def frames() -> Iterator[Frame]:
    return (frame(index, PLAN) for index in range(PLAN.images))


def check_begun(session: Session, length: int) -> None:
    """The first `length` frames are there as they were taken, and nothing else."""
    found = Session.open(session.path)
    assert [record.index for record in found.records] == list(range(length))
    assert len(list(session.path.glob(f"{FRAMES}/*"))) == length
    for index in range(length):
        np.testing.assert_array_equal(found.read(index), image_of(index))


def give(session: Session, given: Iterator[Frame], observe: FrameObserver = ignore) -> None:
    """Have them all recorded."""
    with write_frames(session, observe) as record:
        for one in given:
            record(one)


class SlowDisk:
    """Stands for a session's `write`: it waits until as many frames are given as may be."""

    def __init__(
        self, session: Session, monkeypatch: pytest.MonkeyPatch, fails_at: int | None = None
    ) -> None:
        self.given, self.begun = 0, 0
        self._fails_at, self._really = fails_at, session.write
        self._changed = threading.Condition()
        monkeypatch.setattr(session, "write", self)

    def watched(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """The same frames, counted as they are given; there is nothing to wait for after the last."""
        try:
            for one in frames:
                self._note(self.given + 1)
                yield one
        finally:
            self._note(PLAN.images)

    def _note(self, given: int) -> None:
        with self._changed:
            self.given = given
            self._changed.notify()

    def __call__(self, frame: Frame) -> None:
        with self._changed:
            ahead = min(self.begun + SESSION_LIMITS.max_waiting_frames + 1, PLAN.images)
            assert self._changed.wait_for(lambda: self.given >= ahead, DEADLOCK_S), "nobody works beside it"
            self.begun += 1
        if frame.index == self._fails_at:
            raise DataError("no space left on the disk")
        self._really(frame)


def test_frames_are_taken_while_others_are_written(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each write waits for those that may be given meanwhile."""
    disk = SlowDisk(session, monkeypatch)
    give(session, disk.watched(frames()))
    assert disk.begun == PLAN.images
    check_begun(session, PLAN.images)


def test_frames_on_disk_are_let_go(session: Session) -> None:
    alive: list[weakref.ref[Image]] = []
    most = 0
    with write_frames(session, lambda frame: None) as record:
        for one in frames():
            alive.append(weakref.ref(one.image))
            record(one)
            del one
            most = max(most, sum(image() is not None for image in alive))
    assert most <= SESSION_LIMITS.max_waiting_frames + 2


def test_lines_stand_in_the_order_of_the_frames(session: Session) -> None:
    """Also when that is not the plan's: who resumes fills gaps."""
    order = [*range(20, 40), *range(20)]
    give(session, (frame(index, PLAN) for index in order))
    assert list(session._records) == order
    assert list(Session.open(session.path)._records) == order


def test_a_frame_is_seen_once_it_is_on_disk(session: Session) -> None:
    seen: list[int] = []
    threads = set()

    def look(frame: Frame) -> None:
        seen.append(frame.index)
        threads.add(threading.current_thread())
        assert Session.open(session.path).record(frame.index)

    give(session, frames(), look)
    assert seen == list(range(PLAN.images))
    assert threads == {threading.current_thread()}


class AtOnce(ThreadPoolExecutor):
    """A thread that is done before anyone can look."""

    def submit(self, work: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        done = super().submit(work, *given, **named)
        wait([done])
        return done


def test_what_is_done_is_told_at_once(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fpplab.sessions.frame_writer.ThreadPoolExecutor", AtOnce)
    seen: list[Frame] = []
    with write_frames(session, seen.append) as record:
        for count, one in enumerate(frames(), 1):
            record(one)
            assert len(seen) == count


@pytest.mark.parametrize("fails_at", [0, 7, 34, 35, 38, 39])
def test_what_cannot_be_written_reaches_the_caller(
    session: Session, monkeypatch: pytest.MonkeyPatch, fails_at: int
) -> None:
    disk = SlowDisk(session, monkeypatch, fails_at)
    with pytest.raises(DataError, match="no space left on the disk"):
        give(session, disk.watched(frames()))
    assert disk.begun == fails_at + 1, "nothing is written after it"
    check_begun(session, fails_at)


class CableError(Exception):
    """What ends an acquisition."""


@pytest.mark.parametrize("end", [CableError, KeyboardInterrupt])
def test_what_was_taken_before_the_end_is_kept(
    session: Session, monkeypatch: pytest.MonkeyPatch, end: type[BaseException]
) -> None:
    def taken() -> Iterator[Frame]:
        yield from islice(frames(), 20)
        raise end

    disk = SlowDisk(session, monkeypatch)
    with pytest.raises(end):
        give(session, disk.watched(taken()))
    check_begun(session, 20)


def test_a_full_disk_is_told_also_when_the_camera_fails(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera_failed = threading.Event()

    def full(frame: Frame) -> None:
        assert camera_failed.wait(DEADLOCK_S)
        raise DataError("no space left on the disk")

    def taken() -> Iterator[Frame]:
        yield frame(0, PLAN)
        camera_failed.set()
        raise CableError

    monkeypatch.setattr(session, "write", full)
    with pytest.raises(DataError, match="no space left") as caught:
        give(session, taken())
    assert isinstance(caught.value.__context__, CableError)


@pytest.mark.parametrize("last", [0, 1, 5, 13, 39])
def test_killed_in_the_middle_it_is_a_shorter_session(session: Session, last: int) -> None:
    """Killed once frame `last` is seen, whatever the thread is doing."""

    def look(frame: Frame) -> None:
        if frame.index == last:
            os.kill(os.getpid(), signal.SIGKILL)

    assert in_a_child(lambda: give(session, frames(), look)) == -signal.SIGKILL
    survivor = Session.open(session.path)
    done = len(survivor.records)
    assert last < done <= PLAN.images
    assert [record.index for record in survivor.records] == list(range(done))
    resumed = Session.resume(session.path, PLAN, complete_too=True)
    give(resumed, (frame(index, PLAN) for index in resumed.missing()))
    check_begun(resumed, PLAN.images)


def test_first_the_frame_is_on_disk_and_then_its_line(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed: list[os.stat_result] = []
    monkeypatch.setattr(os, "fsync", lambda handle: flushed.append(os.fstat(handle)))
    session.write(frame(0, PLAN))
    file = session.path / session.record(0).file
    found = [path.stat() for path in (file, file.parent, session.path / JOURNAL)]
    assert [place.st_ino for place in flushed] == [place.st_ino for place in found]
    assert flushed[0].st_size == file.stat().st_size, "whole, before its name and its line are there"


# --- the file of a frame -------------------------------------------------------------------------


@given(width=st.integers(1, 70), height=st.integers(1, 70), dtype=st.sampled_from([np.uint8, np.uint16]))
def test_head_and_pixels_are_the_file_that_tifffile_writes(
    width: int, height: int, dtype: type[np.uint8 | np.uint16]
) -> None:
    image = (np.arange(width * height) * 257 % 65521).astype(dtype).reshape(height, width)
    file = BytesIO()
    tifffile.imwrite(file, image, photometric="minisblack", metadata=None)
    assert tiff_head(image.shape, image.dtype) + image.tobytes() == file.getvalue()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_frame_is_a_plain_tiff_that_maps_into_memory(session: Session, dtype: type[np.uint8]) -> None:
    padded = np.arange(24 * 17, dtype=dtype).reshape(17, 24)[:, :21]  # as from a buffer with padded rows
    session.write(frame(0, PLAN, padded, bits=8 * np.dtype(dtype).itemsize))
    path = session.path / session.record(0).file
    mapped = tifffile.memmap(path, mode="r")
    assert isinstance(mapped, np.memmap)
    np.testing.assert_array_equal(mapped, padded)
    np.testing.assert_array_equal(session.read(0), padded)


def test_an_observer_that_fails_ends_it(session: Session) -> None:
    def fall_over(frame: Frame) -> None:
        if frame.index == 3:
            raise KeyError("the viewer fell over")

    with pytest.raises(KeyError, match="fell over"):
        give(session, frames(), fall_over)
    done = len(Session.open(session.path).records)
    assert done >= 4
    check_begun(session, done)
    assert (session.path / JOURNAL).read_bytes().count(b"\n") == done
