"""Commands without what only Linux has, and with nothing in the cache; a scan beside the same on Linux."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fpplab.calibration.model import Calibration
from sim.world import World
from tests.support import commands

PRETENDING = "from tests.core.windows import pretend; pretend()\n"
"""Begins every Python process of a command, the twin's Blender too."""
SAME = ("frames", "cloud.ply", "plan.yaml")
"""Parts of a session that do not tell when it was recorded."""


def run(folder: Path, *words: str) -> str:
    """Run a command of fpplab in a folder, without what only Linux has; what it prints."""
    (folder / "site").mkdir(parents=True, exist_ok=True)
    (folder / "site" / "sitecustomize.py").write_text(PRETENDING)
    (folder / "tmp").mkdir(exist_ok=True)
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(folder / "site"), str(commands.ROOT)]),
        "XDG_CACHE_HOME": str(folder / "cache"),
        "TMPDIR": str(folder / "tmp"),
    }
    command = [sys.executable, "-P", "-m", "fpplab", *words]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=500, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def content(folder: Path) -> dict[str, bytes]:
    """All files of the parts that are the same in every run."""
    files = [path for part in SAME for path in (folder / part, *(folder / part).rglob("*")) if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


SCAN = (
    *("scan", "--rig", "rig_demo_quick", "--plan", "plan_nine_images", "--item", "pillars"),
    *("--calibration", "calibration.yaml", "--out", "scan"),
)


def save_calibration(folder: Path) -> None:
    """Write the devices of the rig as they are."""
    of = World.load("world_demo").binned(8)
    devices = of.camera_model(), of.projector_model(), of.T_projector_camera()
    Calibration(*devices, rms_px={"camera": 0.05, "projector": 0.05, "joint": 0.05}).save(
        folder / "calibration.yaml"
    )


@pytest.mark.whole
def test_a_scan_of_the_twin_is_the_same_without_what_only_linux_has(tmp_path: Path) -> None:
    folders = tmp_path / "linux", tmp_path / "windows"
    for folder in folders:
        folder.mkdir()
        save_calibration(folder)
    done = commands.run(*SCAN, cwd=folders[0])
    assert done.code == 0, done.err
    run(folders[1], *SCAN)
    run(folders[1], *SCAN, "--force")
    assert " MB" in run(folders[1], "session", "info", "scan")  # on disk
    run(folders[1], "export", "scan/cloud.ply", "--out", "cloud.csv")
    linux, windows = (content(folder / "scan") for folder in folders)
    assert len(linux) > 9
    assert linux == windows


@pytest.mark.whole
@pytest.mark.parametrize("words", [["plan", "guess", "--help"], ["artefact", "pyramid", "--out", "p.stl"]])
def test_signs_that_a_code_page_lacks_are_replaced(tmp_path: Path, words: list[str]) -> None:
    environment = {
        **os.environ,
        "PYTHONPATH": str(commands.ROOT),
        "PYTHONIOENCODING": "cp437",
        "COLUMNS": "60",
    }
    command = [sys.executable, "-P", "-m", "fpplab", *words]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.decode("cp437")


@pytest.mark.nightly
@pytest.mark.parametrize(
    "words",
    [
        ("demo", "--quick", "--out", "demo"),
        ("dataset", "--rig", "rig_demo_quick", "--count", "2", "--out", "data"),
        ("gamma", "--rig", "rig_demo_quick", "--out", "gamma.yaml"),
        ("doctor",),
    ],
    ids=lambda words: words[0],
)
def test_other_commands_run_without_it(tmp_path: Path, words: tuple[str, ...]) -> None:
    run(tmp_path, *words)
