"""A bug report has what helps, says what it has, and no frames unless they are asked for."""

import json
import zipfile
from pathlib import Path

import pytest

from fpplab.core.errors import ConfigError
from fpplab.sessions.bug_report import write_bug_report
from fpplab.sessions.lock import exclusive_write
from fpplab.sessions.log import begin_session_log
from tests.support.recorded import PLAN, record


@pytest.fixture
def session(tmp_path: Path) -> Path:
    path = record(tmp_path / "part").path
    with exclusive_write(path):
        begin_session_log(path)
    return path


@pytest.mark.parametrize("frames", [False, True])
def test_what_is_in_it(session: Path, tmp_path: Path, frames: bool) -> None:
    (session / "cloud.ply").write_bytes(b"points")
    log = tmp_path / "run.log"
    log.write_text("words\n", encoding="utf-8")
    out = tmp_path / "report.zip"
    listed = write_bug_report(out, [session, log], frames)
    with zipfile.ZipFile(out) as archive:
        names = archive.namelist()
        assert names == [one.name for one in listed]
        contents = archive.read("contents.txt").decode()
        host = json.loads(archive.read("host.json"))
        assert archive.read("2_run.log") == b"words\n"
        assert "part/cloud.ply" in archive.read("1_part/verified.txt").decode(), "it cannot be read"
    assert all(f"{name}  (" in contents for name in names[1:])
    assert {"1_part/plan.yaml", "1_part/log.jsonl", "1_part/journal.jsonl"} <= set(names)
    assert sum(name.endswith(".tif") for name in names) == (PLAN.images if frames else 0)
    assert not any("cloud" in name for name in names)
    assert {"numpy", "opencv-contrib-python-headless"} <= host["packages"].keys()


def test_a_session_that_nothing_reads_is_reported_all_the_same(session: Path, tmp_path: Path) -> None:
    (session / "plan.yaml").write_bytes(b"\xff")
    (session / "journal.jsonl").write_bytes(b"{}\n")
    write_bug_report(tmp_path / "r.zip", [session], frames=False)
    with zipfile.ZipFile(tmp_path / "r.zip") as archive:
        assert "line 1: is not a frame's record" in archive.read("1_part/verified.txt").decode()


def test_a_source_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="there is no such file or session"):
        write_bug_report(tmp_path / "r.zip", [tmp_path / "none"], frames=False)
    assert not (tmp_path / "r.zip").exists()
