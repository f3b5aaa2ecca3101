"""The examples beside a running service do what their first lines say."""

import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from tests.service.test_command import replaying, service
from tests.support.commands import ROOT

EXAMPLES = ROOT / "examples" / "service"


def run(python: Path | str, script: str, *words: object) -> str:
    """What a script prints."""
    command = [str(python), str(EXAMPLES / script), *map(str, words)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def python_with(folder: Path, *packages: str) -> Path:
    """An interpreter of its own with packages that the product does not know."""
    venv.create(folder, with_pip=True)
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    done = subprocess.run(
        [python, "-m", "pip", "install", "-q", *packages],
        capture_output=True,
        text=True,
        check=False,
        timeout=500,
    )
    if done.returncode != 0:
        pytest.skip(f"the package index does not give {', '.join(packages)}: {done.stderr[-200:]}")
    return python


@pytest.mark.whole
def test_a_robot_moves_on_before_the_points_are_known(tmp_path: Path) -> None:
    rig = replaying(tmp_path)
    with service(rig, tmp_path / "out"):
        said = run(sys.executable, "robot_cell.py", rig, tmp_path / "session/plan.yaml", 2).splitlines()
    assert said[:2] == ["robot: part 1 in place", "robot: part 2 in place"]
    assert [line.partition(":")[0] for line in said[2:]] == ["part 1", "part 2"]
    assert all("unverified" in line for line in said[2:])


@pytest.mark.whole
def test_bluesky_counts_scans(tmp_path: Path) -> None:
    rig = replaying(tmp_path)
    python = python_with(tmp_path / "venv", "bluesky", "ophyd-async")
    with service(rig, tmp_path / "out") as (_, token_file):
        said = run(python, "bluesky_detector.py", token_file, tmp_path / "session/plan.yaml")
    events = [line for line in said.splitlines() if line.startswith("event ")]
    assert len(events) == 2
    assert all("'fpplab-verdict': 'unverified'" in line for line in events)
