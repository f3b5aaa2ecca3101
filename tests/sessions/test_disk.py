"""No space left, or no way to write: nothing half-written stays, and the operator is told."""

import errno
import os
import resource
import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import make_directory, refuse_existing, write_atomic, write_text
from fpplab.core.journals import append_line, cut_torn_line, whole_lines
from fpplab.core.session_names import FRAMES, JOURNAL
from fpplab.sessions.session import Session
from tests.support.recorded import PLAN, KillAtLine, frame, image_of, in_a_child, record


class FullAt:
    """Stands for an os call: the n-th finds no space."""

    def __init__(self, n: int, really: Callable[..., object]) -> None:
        self.left, self.really = n, really

    def __call__(self, *args: object) -> object:
        self.left -= 1
        if self.left == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return self.really(*args)


@pytest.mark.parametrize("n", [1, 2])
def test_a_full_disk_while_a_frame_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, n: int
) -> None:
    session = record(tmp_path / "session", 2)
    before = (session.path / JOURNAL).read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", FullAt(n, os.fsync))
        with pytest.raises(DataError, match="no space left on the disk; free some and run the same"):
            session.write(frame(2))
    assert (session.path / JOURNAL).read_bytes() == before
    assert not list((session.path / FRAMES).glob(".*"))
    assert session.missing() == Session.open(session.path).missing() == [2, 3]
    session.write(frame(2))
    np.testing.assert_array_equal(Session.open(session.path).read(2), image_of(2))


def test_a_full_disk_while_a_session_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for n in (1, 2, 3):
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", FullAt(n, os.fsync))
            with pytest.raises(DataError, match="no space left"):
                Session.create(tmp_path / "session", PLAN, {"name": "rig"})
        assert list(tmp_path.iterdir()) == []


def limited(size: int, work: Callable[[], object]) -> int:
    """Run `work` where no file may grow beyond `size` bytes."""

    def child() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        work()

    return in_a_child(child)


def test_a_frame_that_the_system_refuses_to_write(tmp_path: Path) -> None:
    """The kernel's own refusal, which comes in the middle of a write."""
    session = record(tmp_path / "session", 1)
    big = np.zeros((200, 200), np.uint8)

    def work() -> None:
        with pytest.raises(DataError, match=r"frames/0001_.*: cannot be written \(.+\)$") as caught:
            session.write(frame(1, image=big))
        assert "None" not in str(caught.value)

    assert limited(20_000, work) == 0
    assert len(list((session.path / FRAMES).iterdir())) == 1
    assert Session.open(session.path).missing() == [1, 2, 3]


@pytest.mark.parametrize("room", [0, 1, 7, 8])
def test_a_line_that_the_system_refuses_to_write(tmp_path: Path, room: int) -> None:
    journal = tmp_path / "journal"
    journal.write_bytes(b"x" * 4000 + b"\n")

    def work() -> None:
        with pytest.raises(DataError, match=r"cannot be written \(File too large\)"):
            append_line(journal, "a line of more than eight")

    assert limited(4001 + room, work) == 0
    assert journal.read_bytes() == b"x" * 4000 + b"\n"


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        (b"", []),
        (b"torn", []),
        (b"one\n", [b"one"]),
        (b"one\n\n", [b"one", b""]),
        (b"one\ntwo\nto", [b"one", b"two"]),
        (b"one\n" + b"x" * 100_000, [b"one"]),
        (b"x" * 100_000 + b"\ntorn\r", [b"x" * 100_000]),
    ],
)
def test_a_torn_line_is_none_and_is_cut_off(tmp_path: Path, text: bytes, lines: list[bytes]) -> None:
    journal = tmp_path / "journal"
    journal.write_bytes(text)
    assert whole_lines(journal) == lines
    cut_torn_line(journal)
    assert journal.read_bytes() == b"".join(line + b"\n" for line in lines)
    append_line(journal, "next")
    assert whole_lines(journal) == [*lines, b"next"]


def test_a_journal_without_a_torn_line_is_left_alone(tmp_path: Path) -> None:
    journal = tmp_path / "journal"
    journal.write_bytes(b"one\n")
    journal.chmod(0o444)
    os.utime(journal, (0, 0))
    cut_torn_line(journal)
    assert journal.stat().st_mtime == 0


def test_a_text_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "results" / "x.yaml"
    write_text(path, "old")

    def work() -> None:
        with pytest.raises(DataError, match="File too large"):
            write_text(path, "new" * 10_000)

    assert limited(1000, work) == 0
    assert path.read_text() == "old"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.whole
def test_killed_at_any_line_a_result_is_the_old_or_the_new(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    for n in count():
        path.write_text("old")

        def work(n: int = n) -> None:
            sys.settrace(KillAtLine(n))
            write_text(path, "new, and longer")
            sys.settrace(None)

        ended = in_a_child(work)
        assert path.read_text() in ("old", "new, and longer")
        if ended == 0:
            break
    assert n > 8


def test_a_writer_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def interrupted(stream: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomic(tmp_path / "x", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make_directory(tmp_path / "y", interrupted)
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(DataError, match="cannot be written"):
        write_text(tmp_path / "file" / "x.yaml", "text")
    with pytest.raises(DataError, match="cannot be written"):
        Session.create(tmp_path / "file" / "session", PLAN)
    with pytest.raises(DataError, match=r"journal: cannot be written \(No such file or directory\)"):
        append_line(tmp_path / "journal", "line")
    with pytest.raises(DataError, match=r"journal: cannot be written \(No such file or directory\)"):
        cut_torn_line(tmp_path / "journal")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_an_output_that_exists_needs_force(tmp_path: Path) -> None:
    refuse_existing(tmp_path / "new", force=False)
    (tmp_path / "old").write_text("x")
    with pytest.raises(ConfigError, match=r"old: exists already; name another output, or add --force"):
        refuse_existing(tmp_path / "old", force=False)
    refuse_existing(tmp_path / "old", force=True)


def test_others_may_read_what_is_written(tmp_path: Path) -> None:
    write_text(tmp_path / "x", "é")
    assert (tmp_path / "x").stat().st_mode & 0o777 == 0o644
    assert (tmp_path / "x").read_bytes() == "é".encode()
