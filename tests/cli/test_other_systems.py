"""Commands without what only Linux has, beside the same on Linux: they end well, and with the same bytes."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from fpplab.calibration.model import Calibration
from sim.world import World
from tests.setup.live.benches import rig_file
from tests.support import commands

PRETENDING = "from tests.core.windows import pretend; pretend()\n"
"""Begins every Python process of a command, the twin's Blender too."""
TIMED = {
    *("calibration.yaml", "demo.json", "files.jsonl", "journal.jsonl", "match.jsonl", "origin.yaml"),
    "verdict.yaml",
}
"""Files that tell when and in how many seconds they came about, as pages do; logs tell nothing else."""
TIMES = re.compile(
    rb'\d{4}-\d\d-\d\d[T ][\d:.+]+(Z| UTC)?|"(host_time_s|seconds)": [\d.e+-]+|\b[\d.]+ s\b'
    rb'|data:(?:text/csv|application/json)[^"]*'  # tables of pages, which are in them as text too
    rb'|"calibration\.yaml", "sha256": "\w+"|Calibration age</th>.*'
)


def run(folder: Path, *words: object, **environment: str) -> str:
    """Run a command of fpplab in a folder, without what only Linux has; what it prints."""
    aside = folder.with_name(f"{folder.name}_aside")
    (aside / "tmp").mkdir(parents=True, exist_ok=True)
    (aside / "sitecustomize.py").write_text(PRETENDING)
    used = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(aside), str(commands.ROOT)]),
        "XDG_CACHE_HOME": str(aside / "cache"),
        "TMPDIR": str(aside / "tmp"),
        **environment,
    }
    command = [sys.executable, "-P", "-m", "fpplab", *map(str, words)]
    done = subprocess.run(
        command, cwd=folder, env=used, capture_output=True, text=True, timeout=500, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def content(folder: Path) -> dict[str, bytes]:
    """All files in a folder, without times; of logs, whether lines end as elsewhere."""
    files = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    return {name: _content(files[name]) for name in sorted(files)}


def _content(path: Path) -> bytes:
    if path.name == "log.jsonl":
        return b"\r" if b"\r" in path.read_bytes() else b""
    has_times = path.name in TIMED or path.suffix == ".html"
    return TIMES.sub(b"", path.read_bytes()) if has_times else path.read_bytes()


def same(linux: Path, windows: Path) -> int:
    """How many files both folders hold, all the same."""
    ours, theirs = content(windows), content(linux)
    assert list(ours) == list(theirs)
    assert [name for name in ours if ours[name] != theirs[name]] == []
    return len(ours)


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """For Linux and for what pretends to be Windows: a calibration of the rig as it is, and a small bench."""
    of = World.load("world_demo").binned(8)
    devices = of.camera_model(), of.projector_model(), of.T_projector_camera()
    made = tmp_path / "linux", tmp_path / "windows"
    for folder in made:
        rig_file(folder)
        rms_px = {"camera": 0.05, "projector": 0.05, "joint": 0.05}
        Calibration(*devices, rms_px=rms_px).save(folder / "calibration.yaml")
    return made


def both(folders: tuple[Path, Path], *words: object, **environment: str) -> tuple[commands.Outcome, str]:
    """Run a command on both."""
    done = commands.run(*words, cwd=folders[0])
    assert done.code == 0, done.err
    return done, run(folders[1], *words, **environment)


@pytest.mark.whole
def test_a_scan_of_the_twin_is_the_same_without_what_only_linux_has(folders: tuple[Path, Path]) -> None:
    scan = (
        *("scan", "--plan", "plan_nine_images", "--item", "pillars", "--calibration", "calibration.yaml"),
        *("--rig", "rig_demo_quick", "--out", "scan"),
    )
    run(folders[1], *scan, "--report", "no")
    both(folders, *scan, "--force")
    both(folders, "export", "scan/cloud.ply", "--out", "cloud.csv")
    assert " MB" in run(folders[1], "session", "info", "scan")  # on disk
    assert same(*folders) > 20


@pytest.mark.whole
def test_real_drivers_on_emulators_see_the_same(folders: tuple[Path, Path]) -> None:
    both(
        folders, "scan", "--rig", "rig_emulated_quick", "--plan", "plan_nine_images", "--item", "pillars",
        "--calibration", "calibration.yaml", "--out", "scan", "--report", "no",
    )  # fmt: skip
    assert same(*folders) > 20


@pytest.mark.whole
def test_a_rig_is_set_up_live(folders: tuple[Path, Path]) -> None:
    done, out = both(folders, "live", "--rig", "rig_small.yaml", "--no-view", "--frames", "10", "--json")
    answers = [{**answer, "rate_hz": 0} for answer in (done.json, json.loads(out))]
    assert answers[0] == answers[1]
    assert answers[0]["frames"] == 10


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


@pytest.fixture(scope="module")
def nothing_compiled(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A cache of numba that is empty at first."""
    return str(tmp_path_factory.mktemp("numba"))


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
def test_other_commands_give_the_same(
    folders: tuple[Path, Path], nothing_compiled: str, words: tuple[str, ...]
) -> None:
    both(folders, *words, NUMBA_CACHE_DIR=nothing_compiled)
    same(*folders)
