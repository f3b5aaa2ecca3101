"""Damaged sessions: all that is wrong is named, what is whole is kept, and nothing is deleted."""

from collections.abc import Callable
from pathlib import Path

import pytest

from fpplab.core.errors import ConfigError, DataError, FppError
from fpplab.sessions.inspection import describe_session, session_faults
from fpplab.sessions.repair import repair_session
from fpplab.sessions.session import Session
from tests.sessions.test_damage import PLAN, RIG
from tests.support.recorded import frame


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    session = Session.create(tmp_path / "s", PLAN, RIG)
    for index in range(PLAN.images):
        session.write(frame(index))
    return session.path


def change(path: Path, name: str) -> None:
    content = bytearray((path / name).read_bytes())
    content[len(content) // 2] ^= 1
    (path / name).write_bytes(content)


def cut(path: Path, name: str) -> None:
    (path / name).write_bytes((path / name).read_bytes()[:5])


def gone(path: Path, name: str) -> None:
    (path / name).unlink()


def garbage(path: Path, name: str) -> None:
    with (path / name).open("ab") as stream:
        stream.write(b"\xffgarbage\n")


def all_files(path: Path) -> dict[str, bytes]:
    return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}


def test_a_whole_session_is_left_as_it_is(whole: Path) -> None:
    before = all_files(whole)
    assert session_faults(whole) == []
    report = repair_session(whole)
    assert (report.is_unchanged, report.kept) == (True, 4)
    assert all_files(whole) == before
    assert describe_session(Session.open(whole))["format"] == 2


@pytest.mark.parametrize("name", ["plan.yaml", "rig.yaml", "session.yaml"])
@pytest.mark.parametrize("harm", [change, cut, gone])
def test_small_files_are_restored_from_their_copies(
    whole: Path, name: str, harm: Callable[[Path, str], None]
) -> None:
    before = all_files(whole)
    harm(whole, name)
    assert session_faults(whole)
    report = repair_session(whole)
    assert report.restored == [f"{name}, from its copy in files.jsonl"]
    assert report.kept == 4
    after = all_files(whole)
    assert {key: after[key] for key in before} == before
    assert session_faults(whole) == []


@pytest.mark.parametrize("harm", [change, cut, gone])
def test_a_damaged_frame_is_lost_alone(whole: Path, harm: Callable[[Path, str], None]) -> None:
    (name,) = [r.file for r in Session.open(whole).records if r.index == 2]
    if harm is change:
        content = bytearray((whole / name).read_bytes())
        content[-5] ^= 1
        (whole / name).write_bytes(content)
    else:
        harm(whole, name)
    assert [one.file for one in session_faults(whole)] == [name]
    report = repair_session(whole)
    assert report.kept == 3
    assert "frame 2" in report.lost[0]
    session = Session.open(whole)
    assert session.missing() == [2]
    for index in (0, 1, 3):
        session.read(index)
    if harm is not gone:
        assert (whole.with_name("s.damaged") / name).is_file(), "it is kept beside the session"
    assert (whole.with_name("s.damaged") / "journal.jsonl").is_file()
    session = Session.resume(whole, PLAN, RIG)
    session.write(frame(2))
    assert session_faults(whole) == []


def test_lines_that_are_no_records_are_taken_out(whole: Path) -> None:
    garbage(whole, "journal.jsonl")
    with pytest.raises(DataError):
        Session.open(whole)
    report = repair_session(whole)
    assert report.kept == 4
    assert "line 5" in report.lost[0]
    assert Session.open(whole).missing() == []


def test_a_damaged_record_of_checksums_is_written_anew(whole: Path) -> None:
    garbage(whole, "files.jsonl")
    report = repair_session(whole)
    assert "can no longer be verified" in report.lost[0]
    assert Session.open(whole).missing() == []
    change(whole, "rig.yaml")
    with pytest.raises(FppError):
        Session.open(whole).rig()


def test_results_that_cannot_be_read_are_set_aside(whole: Path) -> None:
    (whole / "cloud.ply").write_bytes(b"ply\nno cloud\n")
    report = repair_session(whole)
    assert [Path(one).name for one in report.aside] == ["cloud.ply"]
    assert session_faults(whole) == []


@pytest.mark.parametrize("name", ["plan.yaml", "journal.jsonl"])
def test_what_cannot_be_repaired_is_said_and_left(whole: Path, name: str) -> None:
    (whole / "files.jsonl").unlink()
    (whole / "session.yaml").unlink()
    (whole / name).unlink()
    before = {key: value for key, value in all_files(whole).items() if key != "log.jsonl"}
    with pytest.raises(DataError, match="cannot be repaired"):
        repair_session(whole)
    assert {key: value for key, value in all_files(whole).items() if key != "log.jsonl"} == before


def test_a_folder_that_is_no_session(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is an empty folder; expected a session"):
        session_faults(tmp_path)


@pytest.mark.parametrize(
    ("harm", "name"), [(change, "plan.yaml"), (garbage, "journal.jsonl"), (garbage, "files.jsonl")]
)
def test_a_full_disk_leaves_the_damaged_file_in_its_place(
    whole: Path, harm: Callable[[Path, str], None], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    harm(whole, name)
    before = (whole / name).read_bytes()

    def full(path: Path, text: str) -> None:
        raise DataError(f"{path}: no space left on the disk")

    with monkeypatch.context() as patch:
        patch.setattr("fpplab.sessions.repair.write_text", full)
        with pytest.raises(DataError, match="no space left"):
            repair_session(whole)
    assert (whole / name).read_bytes() == before
    assert not (whole.with_name("s.damaged") / name).exists()
    assert repair_session(whole).kept == 4
    assert (whole.with_name("s.damaged") / name).read_bytes() == before
