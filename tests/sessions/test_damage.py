"""What is changed, put, left or taken in a session behind fpplab's back."""

import os
import shutil
from pathlib import Path

import pytest

from fpplab.calibration.model import Calibration
from fpplab.core.checksums import check_recorded, write_recorded
from fpplab.core.errors import ConfigError, DataError, FppError
from fpplab.core.files import sweep_file_drafts, write_atomic, write_text
from fpplab.sessions.inspection import session_faults
from fpplab.sessions.session import Session
from tests.comparison.test_comparison import CALIBRATION
from tests.support.recorded import PLAN, frame, in_a_child, record

RIG = {"name": "one", "resolved": {"projector": {"size": [64, 48], "lattice": "square"}}}


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    session = Session.create(tmp_path / "session", PLAN, RIG)
    for index in range(PLAN.images):
        session.write(frame(index))
    write_recorded(session.path / "calibration.yaml", CALIBRATION.to_yaml("calibration.yaml"))
    return session.path


def read(path: Path) -> None:
    """Everything that decides what the frames mean."""
    session = Session.open(path)
    session.rig()
    session.stack()
    Calibration.load(path / "calibration.yaml")


@pytest.mark.parametrize("name", ["plan.yaml", "rig.yaml", "calibration.yaml"])
def test_any_changed_byte_is_found(whole: Path, name: str) -> None:
    read(whole)
    content = (whole / name).read_bytes()
    for place in range(0, len(content), 7):
        changed = bytearray(content)
        changed[place] ^= 2
        (whole / name).write_bytes(changed)
        with pytest.raises(FppError):
            read(whole)
    (whole / name).write_bytes(content + b"# checked by hand\n")
    with pytest.raises(DataError, match=rf"{name}: was changed since the session wrote it"):
        read(whole)
    (whole / name).write_bytes(content)
    read(whole)


def test_a_session_without_checksums_is_read(whole: Path) -> None:
    (whole / "files.jsonl").unlink()
    with pytest.raises(DataError, match=r"files.jsonl is gone"):
        read(whole)
    (whole / "session.yaml").unlink()  # as version 0.1.0 left it
    (whole / "rig.yaml").write_text("name: two\nresolved: {}\n", encoding="utf-8")
    read(whole)


def test_a_crash_between_a_checksum_and_its_file(whole: Path) -> None:
    """The old file stays valid; so does the new one, once it is written."""
    path, record_file = whole / "calibration.yaml", whole / "files.jsonl"
    old = path.read_bytes()
    write_recorded(path, "new: 1\n")
    path.write_bytes(old)
    check_recorded(path, old)
    check_recorded(path, b"new: 1\n")
    with pytest.raises(DataError, match="was changed"):
        check_recorded(path, b"new: 2\n")
    with record_file.open("ab") as stream:
        stream.write(b'{"file": "cal')
    write_recorded(path, "newer: 1\n")
    check_recorded(path, b"newer: 1\n")
    with record_file.open("ab") as stream:
        stream.write(b"{}\n")
    with pytest.raises(DataError, match=r"files.jsonl line 7: is not the checksum"):
        check_recorded(path, b"newer: 1\n")


def test_a_damaged_calibration_is_among_a_session_s_faults(whole: Path) -> None:
    assert session_faults(whole) == []
    path = whole / "calibration.yaml"
    path.write_text(path.read_text().replace("focal_px:", "focal_mm:", 1))
    assert "calibration.yaml" in {fault.file for fault in session_faults(whole)}


@pytest.mark.parametrize("name", ["plan.yaml", "rig.yaml", "calibration.yaml", "frame"])
def test_a_pipe_in_place_of_a_file_is_refused_at_once(whole: Path, name: str) -> None:
    path = whole / (Session.open(whole).record(2).file if name == "frame" else name)
    path.unlink()
    os.mkfifo(path)

    def look() -> None:
        with pytest.raises((DataError, ConfigError), match=r"pipe or a device|is not a session"):
            read(whole)

    assert in_a_child(look) == 0


def test_force_keeps_what_is_not_fpplabs(whole: Path) -> None:
    (whole / ".calibration.yaml.ab12cd_9").write_text("draft")
    (whole / "frames" / "notes.txt").write_text("mine")
    (whole / "wedding.png").write_bytes(b"dear")
    (whole / "more").mkdir()
    for make in (Session.create, Session.resume):
        with pytest.raises(DataError, match=r"\(frames/notes.txt, more, wedding.png\), so --force does not"):
            make(whole, PLAN, force=True)
    assert (whole / "wedding.png").read_bytes() == b"dear"
    read(whole)
    for name in ("frames/notes.txt", "wedding.png"):
        (whole / name).unlink()
    (whole / "more").rmdir()
    assert Session.create(whole, PLAN, force=True).missing() == [0, 1, 2, 3]


def test_force_keeps_what_a_link_in_place_of_the_frames_leads_to(whole: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    (whole / "frames").rename(elsewhere)
    (elsewhere / "notes.txt").write_text("mine")
    (whole / "frames").symlink_to(elsewhere)
    with pytest.raises(DataError, match=r"not part of a session \(frames\), so --force does not"):
        Session.create(whole, PLAN, force=True)
    assert (elsewhere / "notes.txt").read_text() == "mine"
    (whole / "frames").unlink()
    assert Session.create(whole, PLAN, force=True).missing() == [0, 1, 2, 3]
    assert (elsewhere / "notes.txt").read_text() == "mine"


def test_drafts_of_killed_processes_are_taken_away(tmp_path: Path) -> None:
    session = record(tmp_path / "s", 2)

    def work() -> None:
        write_atomic(session.path / "cloud.ply", lambda stream: os._exit(9))

    assert in_a_child(work) == 9
    mine = session.path / ".cloud.ply.notes"
    mine.write_text("no draft")
    assert len(list(session.path.glob(".cloud.ply.*"))) == 2
    Session.resume(session.path, PLAN)
    assert list(session.path.glob(".cloud.ply.*")) == [mine]
    assert in_a_child(work) == 9
    write_text(session.path / "cloud.ply", "whole")
    assert list(session.path.glob(".cloud.ply.*")) == [mine]


def test_the_draft_of_a_living_process_stays(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"

    def during(stream: object) -> None:
        assert in_a_child(lambda: sweep_file_drafts(path)) == 0
        assert len(list(tmp_path.iterdir())) == 1

    write_atomic(path, during)
    assert [one.name for one in tmp_path.iterdir()] == ["cloud.ply"]


@pytest.mark.parametrize("gone", ["", "journal.jsonl", "frames/0002_x.tif"])
def test_a_session_that_is_removed_meanwhile_is_no_result(whole: Path, gone: str) -> None:
    session = Session.open(whole)
    session.check_kept()
    if gone:
        (whole / (session.record(2).file if gone.startswith("frames") else gone)).unlink()
    else:
        shutil.rmtree(whole)
        write_text(whole / "report.html", "a report alone")
    with pytest.raises(DataError, match="was removed while it was measured"):
        session.check_kept()
