"""Wrong input: one clear sentence, the right exit code, nothing left behind."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image as Pillow
from typer.testing import CliRunner

from fpplab.cli.every import app
from tests.support.commands import ROOT, Command, Demo
from tests.support.recorded import image_of


def _changed(name: str, path: Path, change: dict[str, object]) -> Path:
    document = yaml.safe_load((ROOT / "configs" / name).read_text())
    path.write_text(yaml.safe_dump({**document, **change}))
    return path


FRINGE = {"axis": "x", "stripes": 1, "steps": 4}
BAD_PLANS = {
    "unknown key": ({"exposure": 1}, "unknown key 'exposure'"),
    "wrong type": ({"exposure_s": "long"}, "'exposure_s' is 'long'"),
    "out of range": ({"exposure_s": -1}, "'exposure_s' is -1"),
    "two steps": ({"fringes": [{**FRINGE, "steps": 2}]}, "'fringes[0].steps' is 2"),
    "no stripes": ({"fringes": [{**FRINGE, "stripes": 0}]}, "'fringes[0].stripes' is 0"),
    "too many stripes": (
        {"fringes": [FRINGE, {**FRINGE, "stripes": 457}]},
        "'fringes[1].stripes' is 457",
    ),
}


@pytest.mark.parametrize(("change", "words"), BAD_PLANS.values(), ids=BAD_PLANS.keys())
def test_wrong_plan(
    fpplab: Command, demo: Demo, tmp_path: Path, change: dict[str, object], words: str
) -> None:
    plan = _changed("plan_paper.yaml", tmp_path / "plan.yaml", change)
    done = fpplab(
        "scan", "--rig", "rig_demo_quick", "--plan", plan,
        "--calibration", demo.folder / "calibration.yaml", "--out", tmp_path / "s", "--json",
    )  # fmt: skip
    assert done.code == 2
    assert str(plan) in done.json["error"]
    assert words in done.json["error"]
    assert not (tmp_path / "s").exists()


BAD_RIGS = {
    "unknown key": ({"lamp": {}}, "unknown key 'lamp'"),
    "no such backend": ({"camera": {"backend": "sim.devices:NoCamera"}}, "'camera.backend'"),
    "not a camera": ({"camera": {"backend": "sim.devices:SimStage"}}, "not a camera"),
    "unknown option": ({"camera": {"backend": "sim.devices:SimCamera", "zoom": 2}}, "zoom"),
    "wrong bits": ({"camera": {"backend": "sim.devices:SimCamera", "bits": 9}}, "'camera.bits' is 9"),
    "no world": ({"bench": {"backend": "sim.devices:VirtualBench", "world": "none.yaml"}}, "none.yaml"),
}


@pytest.mark.parametrize(("change", "words"), BAD_RIGS.values(), ids=BAD_RIGS.keys())
def test_wrong_rig(
    fpplab: Command, demo: Demo, tmp_path: Path, change: dict[str, object], words: str
) -> None:
    rig = _changed("rig_demo_quick.yaml", tmp_path / "rig.yaml", change)
    done = fpplab(
        "scan", "--rig", rig, "--calibration", demo.folder / "calibration.yaml",
        "--out", tmp_path / "s", "--json",
    )  # fmt: skip
    assert done.code == 2
    assert words in done.json["error"]
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"holes": 3}, "unknown key 'holes'"),
        ({"kind": "hexagons"}, "'kind' is 'hexagons'"),
        ({"size_mm": [10.0, 10.0]}, "target.yaml"),
    ],
)
def test_wrong_target(
    fpplab: Command, demo: Demo, tmp_path: Path, change: dict[str, object], words: str
) -> None:
    target = _changed("target_paper.yaml", tmp_path / "target.yaml", change)
    done = fpplab(
        "characterise", demo.folder / "board", "--target", target, "--out", tmp_path / "c.yaml", "--json"
    )
    assert done.code == 2
    assert words in done.json["error"]


def test_calibration_of_another_sensor(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    text = (demo.folder / "calibration.yaml").read_text()
    document = yaml.safe_load(text)
    del document["checksum"]  # the change is meant
    document["camera"]["size"] = [1368, 912]
    other = tmp_path / "other.yaml"
    other.write_text(yaml.safe_dump(document))
    done = fpplab(
        "reconstruct", demo.folder / "steps", "--calibration", other, "--out", tmp_path / "c.ply", "--json"
    )
    assert done.code == 5
    assert "684 x 456" in done.json["error"]
    assert "1368 x 912" in done.json["error"]


def test_missing_frame_is_named(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    import shutil

    session = tmp_path / "s"
    shutil.copytree(demo.folder / "steps", session)
    next((session / "frames").glob("0007_*")).unlink()
    done = fpplab("decode", session, "--out", tmp_path / "x.npz", "--json")
    assert done.code == 4
    assert "frame 7" in done.json["error"]
    assert not (tmp_path / "x.npz").exists()


BAD_IMAGES = {
    "16 bits": (
        image_of(2).astype(np.uint16) * 257,
        "f_02.png: holds 16-bit grey levels but the first image 8-bit ones",
    ),
    "colour": (
        np.arange(16 * 20 * 3, dtype=np.uint8).reshape(16, 20, 3),
        "f_02.png: is in colour: its channels differ by up to",
    ),
    "another size": (
        np.zeros((16, 21), np.uint8),
        "f_02.png: is 21 x 16 pixels but the first image is 20 x 16",
    ),
    "a duplicate": (image_of(0), "f_02.png: is the same image as f_00.png"),
    "missing": (None, "1 of the plan's 4 frames are missing (f_02.png)"),
}


@pytest.mark.parametrize(("image", "words"), BAD_IMAGES.values(), ids=BAD_IMAGES.keys())
def test_wrong_loose_images(
    fpplab: Command, tmp_path: Path, image: np.ndarray[tuple[int, ...], np.dtype[np.uint8]] | None, words: str
) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(yaml.safe_dump({"fringes": [FRINGE]}))
    for index in range(4):
        wanted = image if index == 2 else image_of(index)
        if wanted is not None:
            Pillow.fromarray(wanted).save(tmp_path / f"f_{index:02d}.png")
    done = fpplab(
        "import", tmp_path, "--plan", plan, "--frames", "f_{index:02d}.png", "--out", tmp_path / "s",
        "--projector-size", 64, 48, "--json",
    )  # fmt: skip
    assert done.code == 4
    assert words in done.json["error"]
    assert not (tmp_path / "s").exists()


def test_not_a_session(fpplab: Command, tmp_path: Path) -> None:
    done = fpplab("decode", tmp_path, "--out", tmp_path / "x.npz", "--json")
    assert done.code == 4
    assert "is an empty folder; expected a session" in done.json["error"]


def test_wrong_usage_is_still_one_json_object(fpplab: Command) -> None:
    done = fpplab("scan", "--json")
    assert done.code == 2
    assert done.json["exit_code"] == 2


def test_unknown_benchmark_lists_the_known() -> None:
    command = [sys.executable, "-m", "benchmarks", "nothing", "--json"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "decode" in json.loads(done.stdout)["error"]


@pytest.mark.whole
def test_help_teaches_every_command() -> None:
    folders = (ROOT / "fpplab/cli/commands", ROOT / "sim/commands")
    files = [path for folder in folders for path in folder.glob("[a-z]*.py")]
    commands = [path.stem.strip("_").replace("_", "-") for path in files]
    assert len(commands) >= 19
    for command in commands:
        said = CliRunner().invoke(app, [command, "--help"])
        assert said.exit_code == 0
        assert len(said.output) > 200


def test_the_commands_are_known_without_what_they_need() -> None:
    heavy = ["bpy", "cv2", "hid", "matplotlib", "numba", "pypylon", "rerun", "scipy", "sdl2", "serial"]
    code = f"import sys, fpplab.cli.every; print(sorted(set(sys.modules) & set({heavy})))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_devices_lists_the_emulated_cameras(fpplab: Command) -> None:
    done = fpplab("devices", "--json", env={"PYLON_CAMEMU": "2"})
    assert done.code == 0, done.err
    cameras = [d for d in done.json["devices"] if d["kind"] == "camera"]
    assert {c["serial"] for c in cameras} >= {"0815-0000", "0815-0001"}
    assert all({"kind", "model", "serial", "link", "example"} <= d.keys() for d in done.json["devices"])


def test_artefacts_are_written_once(fpplab: Command, tmp_path: Path) -> None:
    out = tmp_path / "pyramid.stl"
    done = fpplab("artefact", "pyramid", "--out", out, "--json")
    assert done.code == 0, done.err
    assert out.stat().st_size == 84 + 50 * done.json["faces"]  # binary STL
    assert fpplab("artefact", "pyramid", "--out", out, "--json").code == 2
    wrong = fpplab("artefact", "cone", "--out", tmp_path / "cone.stl", "--json")
    assert wrong.code == 2
    assert "pillars" in wrong.json["error"]
