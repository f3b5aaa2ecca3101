"""`fpplab scan` has a running service measure, and gives what it gives without one."""

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml

from fpplab import ServiceClient
from tests.cli.test_verdict import recorded
from tests.support.commands import ROOT, Command
from tests.support.faulty_bench import healthy

TIMED = {"journal.jsonl", "log.jsonl", "origin.yaml", "report.html", "verdict.yaml"}
"""Files that hold times."""


def replaying(folder: Path) -> Path:
    """A rig that replays a recorded session, beside its plan and calibration."""
    recorded(healthy(101), folder)
    rig = {
        "name": "replay",
        "bench": {"backend": "recorded_session", "session": str(folder / "session")},
        "camera": {"backend": "replay_camera", "bits": 12},
        "projector": {"backend": "replay_projector"},
    }
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig))
    return folder / "rig.yaml"


@contextmanager
def service(rig: Path, out: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """`fpplab serve`, ready, and the file that says where it is."""
    words = [
        "serve",
        "--rig",
        rig,
        "--calibration",
        rig.with_name("calibration.yaml"),
        "--out",
        out,
        "--json",
    ]
    command = [sys.executable, "-m", "fpplab", *map(str, words)]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as run:
        assert run.stdout is not None
        try:
            yield run, Path(json.loads(run.stdout.readline())["token_file"])
        finally:
            run.kill()


@pytest.mark.whole
def test_a_scan_by_the_service_is_that_of_the_command(fpplab: Command, tmp_path: Path) -> None:
    rig = replaying(tmp_path)
    for folder in ("without", "with"):
        (tmp_path / folder).mkdir()
    given = (
        "--rig",
        rig,
        "--plan",
        tmp_path / "session/plan.yaml",
        "--calibration",
        tmp_path / "calibration.yaml",
    )
    words = ("scan", *given, "--out", "scan", "--json")
    alone = fpplab(*words, cwd=tmp_path / "without")
    with service(rig, tmp_path / "out") as (run, _):
        served = fpplab(*words, cwd=tmp_path / "with")
        assert "Measured by the service" in served.err
        again = fpplab(*words, cwd=tmp_path / "with")
        assert (again.code, "exists already" in again.err) == (2, True)
        viewed = fpplab(*words, "--view", "--force", cwd=tmp_path / "with")
        assert (viewed.code, "--view" in viewed.err) == (2, True)
        run.send_signal(signal.SIGTERM)
        assert run.wait(30) == 0
    assert (alone.code, served.code) == (0, 0), served.err
    assert list(alone.json) == list(served.json)
    ours, theirs = (
        {k: v for k, v in done.json.items() if k not in ("seconds", "provenance")} for done in (alone, served)
    )
    assert ours == theirs
    same_files(tmp_path / "with/scan", tmp_path / "without/scan")
    assert ServiceClient.find(rig) is None


def same_files(ours: Path, theirs: Path) -> None:
    files = {path.relative_to(ours) for path in ours.rglob("*") if path.is_file()}
    assert files == {path.relative_to(theirs) for path in theirs.rglob("*") if path.is_file()}
    for file in files:
        assert file.name in TIMED or (ours / file).read_bytes() == (theirs / file).read_bytes(), file


@pytest.mark.whole
def test_a_killed_service_finishes_what_has_its_frames(tmp_path: Path) -> None:
    rig = replaying(tmp_path)
    with service(rig, tmp_path / "out") as (run, _):
        client = ServiceClient.of_rig(rig)
        scan = client.order(str(tmp_path / "session/plan.yaml"))
        client.wait(scan, "judged", 60)
        run.kill()
        run.wait()
    with service(rig, tmp_path / "out"):
        status = ServiceClient.of_rig(rig).wait(scan, timeout_s=60)
        assert status["result"]["points"] > 1000
        assert (tmp_path / "out/scan_0001/report.html").is_file()
