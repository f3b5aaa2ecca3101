"""A display projector and a video camera: characterised by one command, and a card measured by another."""

import json
import shutil
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers import computer_discovery
from fpplab.calibration.model import Calibration
from fpplab.cli.every import app
from fpplab.clouds import load_cloud
from fpplab.core.conventions import Floats
from sim.items import item_poses
from sim.world import World
from tests.drivers.screen_scene import DISPLAY_PX, write_scene
from tests.drivers.x_screen import ScreenAndVideoBench
from tests.support.commands import run

pytestmark = [
    pytest.mark.whole,
    pytest.mark.skipif(shutil.which("Xvfb") is None, reason="no Xvfb on this computer"),
]


def fpplab(folder: Path, *words: str) -> dict[str, Any]:
    """What a command answers, in a process of its own."""
    done = run(*words, "--json", cwd=folder)
    assert done.code == 0, done.err
    return done.json


def rms_from_true_card_mm(points: Floats, world: World) -> float:
    pose = item_poses(world, "grey_card")[0]
    return float(np.sqrt(np.mean(((points - pose.translation) @ pose.rotation[:, 2]) ** 2)))


def rms_from_own_plane_mm(points: Floats) -> float:
    return float(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2] / np.sqrt(len(points)))


def test_a_card_is_where_and_as_flat_as_it_is(tmp_path: Path) -> None:
    """The board of a characterisation alone tells camera and projector how large the world is."""
    world = write_scene(tmp_path)
    board = ("--plan", "plan_board.yaml", "--target", "board.yaml", "--poses", "8")
    found = fpplab(tmp_path, "characterise", "--rig", "rig.yaml", *board, "--out", "calibration.yaml")
    assert (found["verdict"], found["poses"], found["points"]) == ("good", 8, 416)
    assert found["joint_rms_px"] < 0.01
    card = ("--plan", "plan_card.yaml", "--calibration", "calibration.yaml", "--item", "grey_card")
    measured = fpplab(tmp_path, "scan", "--rig", "rig.yaml", *card, "--out", "card")
    assert measured["verdict"] == "unverified"
    assert measured["points"] > 0.9 * 384 * 256
    points = load_cloud(tmp_path / "card" / "cloud.ply").points
    own, true = rms_from_own_plane_mm(points), rms_from_true_card_mm(points, world)
    print(f"RMS from its own plane {own:.4f} mm, from the true card {true:.4f} mm")
    assert own < 0.1
    assert true < 0.3


def test_from_what_is_connected_to_a_cloud(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`rig new` finds the display and the camera, tests both, and writes what check and scan take."""
    world = write_scene(tmp_path)
    true = Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(), {})
    true.save(tmp_path / "calibration.yaml")
    listed, nodes = tmp_path / "video4linux" / "video0", tmp_path / "dev"
    listed.mkdir(parents=True)
    nodes.mkdir()
    (listed / "name").write_text("Screen camera")
    (nodes / "video0").touch()
    monkeypatch.chdir(tmp_path)
    bench = ScreenAndVideoBench(
        {"size": DISPLAY_PX, "optics": str(tmp_path / "optics.yaml"), "curve": "srgb"}
    )
    bench.open()
    with closing(bench), monkeypatch.context() as computer:
        for place, there in (("VIDEO_CLASS", listed.parent), ("VIDEO_NODES", nodes)):
            computer.setattr(computer_discovery, place, there)
        computer.setattr("drivers.discovery.usb_devices", lambda: ([], []))
        computer.setattr("drivers.video_camera.camera.VideoDevice", bench.video)
        seen = answer(
            "rig", "new", "--out", "new.yaml", "--no-questions", "--no-operator", "--projector", "0"
        )
        assert seen["camera"]["saturated"] < 0.01
        assert seen["projector"]["white"] > 0.2
        assert "backend: video_camera" in (tmp_path / "new.yaml").read_text()
        plan = ("--rig", "new.yaml", "--plan", "plan_card.yaml")
        assert answer("check", *plan)["ok"]
        calibrated = ("--calibration", "calibration.yaml", "--out", "card")
        assert answer("scan", *plan, *calibrated)["verdict"] == "unverified"
    points = load_cloud(tmp_path / "card" / "cloud.ply").points
    assert rms_from_true_card_mm(points, world) < 0.1


def answer(*words: str) -> dict[str, Any]:
    """What a command answers, in this process."""
    done = CliRunner().invoke(app, [*words, "--json"])
    assert done.exit_code == 0, f"{words}\n{done.output}\n{done.exception}"
    found: dict[str, Any] = json.loads(done.stdout)
    return found
