"""Sessions of every version of the format are read, and brought to the present one when completed."""

import re
import shutil
from pathlib import Path

import pytest

from fpplab.core.errors import DataError
from fpplab.core.session_names import CHECKSUMS, FORMAT
from fpplab.sessions.format import PRESENT, session_format, upgrade_format
from fpplab.sessions.inspection import session_faults
from fpplab.sessions.session import Session
from tests.support.recorded import record

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"
RECORDED = {1: DATA / "version_0_1_0" / "session", 2: DATA / "session_format_2"}
"""A session that was written by the program of each version of the format."""


def test_there_is_a_session_of_every_format_and_of_every_released_version() -> None:
    assert list(RECORDED) == list(range(1, PRESENT + 1))
    versions = re.findall(
        r"^## \[(\d+\.\d+\.\d+)\]", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE
    )
    assert versions
    assert [v for v in versions if not (DATA / f"version_{v.replace('.', '_')}" / "session").is_dir()] == []


@pytest.mark.parametrize("number", RECORDED)
def test_it_is_read_as_it_is(number: int) -> None:
    session = Session.open(RECORDED[number])
    assert session_format(session.path) == number
    assert session.missing() == []
    assert len(session.stack()) == session.plan.images
    session.projector()
    assert session_faults(session.path) == []


def test_a_session_of_version_0_2_0_is_read() -> None:
    session = Session.open(DATA / "version_0_2_0" / "session")
    assert session_faults(session.path) == []
    assert [shown.kind for shown in session.plan.sets] == ["sinusoid", "gray", "even"]
    assert len(session.stack()) == session.plan.images


@pytest.mark.parametrize("number", RECORDED)
def test_it_is_brought_to_the_present_format(number: int, tmp_path: Path) -> None:
    shutil.copytree(RECORDED[number], tmp_path / "s")
    before = Session.open(tmp_path / "s")
    Session.resume(before.path, before.plan, before.rig(), complete_too=True)
    after = Session.open(before.path)
    assert session_format(after.path) == PRESENT
    assert (after.plan, after.rig(), after.records) == (before.plan, before.rig(), before.records)
    (after.path / "plan.yaml").write_bytes((after.path / "plan.yaml").read_bytes() + b"# more\n")
    with pytest.raises(DataError, match="was changed"):
        Session.open(after.path)


def test_an_upgrade_that_was_interrupted_is_made_again(tmp_path: Path) -> None:
    shutil.copytree(RECORDED[1], tmp_path / "s")
    upgrade_format(tmp_path / "s")
    whole = {file.name: file.read_bytes() for file in (tmp_path / "s").iterdir() if file.is_file()}
    (tmp_path / "s" / FORMAT).unlink()
    lines = (tmp_path / "s" / CHECKSUMS).read_bytes().splitlines(keepends=True)
    (tmp_path / "s" / CHECKSUMS).write_bytes(lines[0] + lines[1][:20])
    upgrade_format(tmp_path / "s")
    assert {file.name: file.read_bytes() for file in (tmp_path / "s").iterdir() if file.is_file()} == whole


def test_a_later_format_is_refused(tmp_path: Path) -> None:
    path = record(tmp_path / "s").path
    (path / CHECKSUMS).unlink()
    (path / FORMAT).write_text(f"format: {PRESENT + 1}\n", encoding="utf-8")
    with pytest.raises(
        DataError, match=rf"has format {PRESENT + 1}, of a later version .* reads 1 to {PRESENT}"
    ):
        Session.open(path)
