"""The examples run as their first lines say, on what the demonstration leaves."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import fpplab
from tests.support.commands import ROOT, Demo

EXAMPLES = ROOT / "examples"


def run(script: str, *words: object) -> str:
    """What a script prints; its window is a file."""
    done = subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLES / script), *map(str, words)],
        capture_output=True,
        text=True,
        env={**os.environ, "MPLBACKEND": "agg", "PYTHONPATH": str(ROOT)},
        timeout=540,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def number(text: str, before: str) -> float:
    found = re.search(rf"([\d.]+) {before}", text)
    assert found, text
    return float(found[1])


def test_every_example_is_run_here() -> None:
    here = Path(__file__).read_text(encoding="utf-8")
    scripts = sorted(path.name for path in EXAMPLES.glob("*.py"))
    assert len(scripts) >= 5
    assert [name for name in scripts if f'"{name}"' not in here] == []


@pytest.mark.whole
def test_frames_of_ones_own_are_decoded() -> None:
    said = run("decode_own_frames.py")
    assert number(said, "pixels") == 912 * 64
    assert number(said, "px") < 0.05


def test_a_session_is_decoded_and_plotted(demo: Demo, tmp_path: Path) -> None:
    said = run("decode_and_plot.py", demo.folder / "pyramid", tmp_path / "maps.png")
    assert number(said, "of") > 1e5
    assert (tmp_path / "maps.png").stat().st_size > 10_000


@pytest.mark.whole
def test_a_session_is_reconstructed_and_compared(demo: Demo, tmp_path: Path) -> None:
    folder = demo.folder / "pyramid"
    words = (demo.folder / "calibration.yaml", folder / "truth.stl", tmp_path / "errors.png")
    said = run("reconstruct_and_compare.py", folder, *words)
    scan = next(s for s in demo.answer["scans"] if s["artefact"] == "pyramid")
    assert number(said, "points") == scan["points"]
    assert number(said, "µm") == pytest.approx(scan["surface_smcd_um"], abs=0.06)
    assert (tmp_path / "errors.png").stat().st_size > 10_000


@pytest.mark.whole
def test_a_rig_is_characterised(demo: Demo, tmp_path: Path) -> None:
    poses = tmp_path / "poses"
    poses.mkdir()
    for pose in sorted((demo.folder / "board").glob("pose_*"))[:5]:
        (poses / pose.name).symlink_to(pose)
    said = run("characterise_a_rig.py", poses, "target_paper", tmp_path / "found.yaml")
    assert number(said, "px RMS") < 0.1
    known = fpplab.Calibration.load(demo.folder / "calibration.yaml")
    found = fpplab.Calibration.load(tmp_path / "found.yaml")
    assert found.baseline_mm == pytest.approx(known.baseline_mm, abs=0.5)


def test_a_rig_scans_an_item(demo: Demo, tmp_path: Path) -> None:
    words = ("rig_demo_quick", demo.folder / "calibration.yaml", "steps", tmp_path / "steps")
    said = run("scan_with_a_rig.py", *words)
    scan = next(s for s in demo.answer["scans"] if s["artefact"] == "steps")
    assert number(said, "points") == pytest.approx(scan["points"], rel=0.01)  # other noise
    assert (tmp_path / "steps" / "cloud.ply").is_file()


def test_the_public_names_are_what_they_say() -> None:
    for name in fpplab.__all__:
        assert getattr(fpplab, name) is not None
    assert set(fpplab.__all__) <= set(dir(fpplab))
    with pytest.raises(AttributeError, match="has no attribute 'nonsense'"):
        _ = fpplab.nonsense
