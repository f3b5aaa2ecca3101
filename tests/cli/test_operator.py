"""What an operator in a hurry does: stop, mend, and give the same command again."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from tests.support.commands import ROOT, Command, Demo


def _scan(demo: Demo, out: Path, *more: object) -> list[str]:
    calibration = demo.folder / "calibration.yaml"
    words = ("scan", "--rig", "rig_demo_quick", "--calibration", calibration, "--out", out, "--json", *more)
    return [str(word) for word in words]


def _frames(out: Path) -> int:
    journal = out / "journal.jsonl"
    return journal.read_bytes().count(b"\n") if journal.is_file() else 0


def _stop_midway(words: list[str], out: Path, how: signal.Signals) -> subprocess.CompletedProcess[str]:
    """Start a scan and stop it once it has recorded some frames, but not all."""
    command = [sys.executable, "-m", "fpplab", *words]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        while process.poll() is None and _frames(out) < 3:
            time.sleep(0.01)
        process.send_signal(how)
        out_text, err_text = process.communicate(timeout=60)
    return subprocess.CompletedProcess(command, process.returncode, out_text, err_text)


@pytest.mark.parametrize(
    "how",
    [
        signal.SIGINT,
        *(pytest.param(how, marks=pytest.mark.nightly) for how in (signal.SIGTERM, signal.SIGKILL)),
    ],
)
def test_a_stopped_scan_is_completed_by_the_same_command(
    fpplab: Command, demo: Demo, tmp_path: Path, how: signal.Signals
) -> None:
    out = tmp_path / "s"
    words = _scan(demo, out, "--item", "steps")
    stopped = _stop_midway(words, out, how)
    assert "Traceback" not in stopped.stderr
    if how is signal.SIGKILL:
        assert stopped.returncode == -signal.SIGKILL
    else:
        assert stopped.returncode == 130
        assert json.loads(stopped.stdout)["exit_code"] == 130
    kept = _frames(out)
    assert 3 <= kept < 36
    first = (out / "journal.jsonl").read_bytes().split(b"\n")[:kept]
    done = fpplab(*words)
    assert done.code == 0, done.err
    assert done.json["points"] > 90_000
    assert (out / "journal.jsonl").read_bytes().split(b"\n")[:kept] == first


def test_a_scan_that_lacks_only_its_results_is_finished(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    out = tmp_path / "s"
    words = _scan(demo, out, "--item", "steps")
    assert fpplab(*words).code == 0
    again = fpplab(*words)
    assert again.code == 2
    assert "--force" in again.json["error"]
    journal = (out / "journal.jsonl").read_bytes()
    for name in ("cloud.ply", "report.html"):
        (out / name).unlink()
    assert fpplab(*words).code == 0
    assert (out / "cloud.ply").is_file()
    assert (out / "journal.jsonl").read_bytes() == journal


def test_a_wrong_item_leaves_nothing_behind(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    out = tmp_path / "s"
    done = fpplab(*_scan(demo, out, "--item", "teapot"))
    assert done.code == 3
    assert "teapot" in done.json["error"]
    assert not out.exists()


def test_a_plan_that_cannot_be_unwrapped_is_told_before_anything_moves(
    fpplab: Command, demo: Demo, tmp_path: Path
) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(yaml.safe_dump({"fringes": [{"axis": "x", "stripes": 8, "steps": 4}]}))
    done = fpplab(*_scan(demo, tmp_path / "s", "--plan", plan))
    assert done.code == 2
    assert str(plan) in done.json["error"]
    assert "at most 1 stripe" in done.json["error"]
    assert not (tmp_path / "s").exists()


def test_one_pose_given_twice_is_refused(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    pose = demo.folder / "board" / "pose_00"
    done = fpplab(
        "characterise", pose, pose, pose, "--target", "target_paper", "--out", tmp_path / "c.yaml", "--json"
    )
    assert done.code == 2
    assert "twice" in done.json["error"]


def test_a_mesh_in_other_units_is_named_as_such(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    import trimesh

    mesh = trimesh.load_mesh(demo.folder / "steps" / "truth.stl")
    mesh.apply_scale(1000.0).export(tmp_path / "micrometres.stl")
    done = fpplab("compare", demo.folder / "steps" / "cloud.ply", tmp_path / "micrometres.stl", "--json")
    assert done.code == 4
    assert "both must be in mm" in done.json["error"]


def test_swapped_files_are_found_out(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    session = tmp_path / "s"
    shutil.copytree(demo.folder / "steps", session)
    journal = session / "journal.jsonl"
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    for key in ("file", "sha256"):
        lines[3][key], lines[4][key] = lines[4][key], lines[3][key]
    journal.write_text("".join(json.dumps(line) + "\n" for line in lines))
    done = fpplab("decode", session, "--out", tmp_path / "x.npz", "--json")
    assert done.code == 4
    assert "not its own" in done.json["error"]


@pytest.mark.parametrize(
    ("written", "words"),
    [
        ("date: 2020-13-45\n", "rig.yaml"),
        ("[" * 3000, "rig.yaml"),
        ('name: x\nbench: {backend: "sim.devices:SimCamera"}\n', "is missing"),
    ],
)
def test_a_damaged_rig_file_is_one_sentence(
    fpplab: Command, demo: Demo, tmp_path: Path, written: str, words: str
) -> None:
    (tmp_path / "rig.yaml").write_text(written)
    done = fpplab(*_scan(demo, tmp_path / "s", "--rig", tmp_path / "rig.yaml"))
    assert done.code == 2
    assert words in done.json["error"]


@pytest.mark.parametrize(
    ("command", "name"), [("decode", "x.txt"), ("reconstruct", "c.txt"), ("view", "v.txt")]
)
def test_an_output_says_by_its_name_what_it_holds(
    fpplab: Command, demo: Demo, tmp_path: Path, command: str, name: str
) -> None:
    words = [command, demo.folder / "steps", "--out", tmp_path / name, "--json"]
    if command == "reconstruct":
        words += ["--calibration", demo.folder / "calibration.yaml"]
    done = fpplab(*words)
    assert done.code == 2
    assert "must end in" in done.json["error"]
