"""Wrong worlds through the command: exit code 2, one sentence as JSON, nothing left behind."""

from pathlib import Path
from typing import Any

import pytest
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.core import config
from sim.world import World
from tests.support.commands import Command

POSE = {"rotation_deg": [180, 0, 0], "translation_mm": [0, 0, 460]}
AWAY = {"rotation_deg": [180, 0, 0], "translation_mm": [900, 0, 460]}
BOX = trimesh.creation.box((60.0, 50.0, 20.0))


def bench(folder: Path, **changes: Any) -> Path:
    """A rig of few pixels in a folder of its own, with its world, plan and calibration; the rig file."""
    folder.mkdir()
    data: dict[str, Any] = {
        "camera": {"sensor_size": [192, 128], "pixel_um": 68.4, "binning": 1, "focal_mm": 35},
        "projector": {
            "T_camera_projector": {"rotation_deg": [-13.8, -18.1, 2.2], "translation_mm": [150, 0, 0]},
            "leds": {"green": {"lumens": 0.15, "wavelength_nm": 525}},
        },
        "items": {"part": {"mesh": "box.stl", "pose": POSE}},
        "mounted": "part",
        "render": {"subpixels": 1},
    }
    right = config.validate(data, World, "world")
    calibration = Calibration(right.camera_model(), right.projector_model(), right.T_projector_camera(), {})
    calibration.save(folder / "calibration.yaml")
    for section, fields in changes.items():
        data[section] = {**data.get(section, {}), **fields} if isinstance(fields, dict) else fields
    devices = {
        "bench": {"backend": "sim.devices:VirtualBench", "world": "world.yaml"},
        **{
            name: {"backend": f"sim.devices:Sim{name.title()}"} for name in ("camera", "projector", "fixture")
        },
    }
    fringes = [{"axis": "x", "stripes": stripes, "steps": 3} for stripes in (0.9, 8)]
    for name, content in (
        ("world", data),
        ("rig", {"name": "Small", **devices}),
        ("plan", {"fringes": fringes, "exposure_s": 0.02}),
    ):
        (folder / f"{name}.yaml").write_text(config.to_yaml(content))
    BOX.export(folder / "box.stl")
    return folder / "rig.yaml"


def scan(fpplab: Command, rig: Path, *more: str) -> Any:
    return fpplab(
        "scan", "--rig", rig, "--plan", rig.parent / "plan.yaml", "--calibration",
        rig.parent / "calibration.yaml", "--out", rig.parent.parent / "s", "--json", *more,
        cwd=rig.parent.parent, env={"XDG_CACHE_HOME": str(rig.parent / "cache")},
    )  # fmt: skip


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "kind of material": ({"material": {"kind": "velvet"}}, "must have a 'kind' of diffuse, glossy"),
    "name of material": (
        {"items": {"part": {"mesh": "box.stl", "pose": POSE, "material": "wax"}}},
        "'items.part.material' is 'wax'",
    ),
    "transport with bounces": (
        {"render": {"path": "transport", "bounces": 2}},
        "choose path auto, linear or reference",
    ),
    "device unknown": ({"render": {"device": "TPU"}}, "'render.device' is 'TPU'"),
    "device absent": (
        {"render": {"device": "ONEAPI"}},
        "'render.device' is ONEAPI, but there is no ONEAPI device",
    ),
    "out of sight": (
        {"items": {"part": {"mesh": "box.stl", "pose": AWAY}}},
        "sees nothing of the projector's light on 'part' (pose 0, stage at 0 mm); correct 'items.part'",
    ),
    "no such mesh": (
        {"items": {"part": {"mesh": "ball.stl", "pose": POSE}}},
        "'items.part.mesh': ball.stl: there is no such file",
    ),
    "no mesh": (
        {"items": {"part": {"mesh": "world.yaml", "pose": POSE}}},
        "world.yaml",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("changes", "words"), WRONG.values(), ids=WRONG.keys())
def test_wrong_world(fpplab: Command, tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    done = scan(fpplab, bench(tmp_path / "bench", **changes))
    assert done.code == done.json["exit_code"] == 2
    assert words in done.json["error"]
    assert "\n" not in done.json["error"]
    assert {path.name for path in tmp_path.iterdir()} == {"bench"}


def test_wrong_item_that_is_not_mounted_yet(fpplab: Command, tmp_path: Path) -> None:
    """Found before the session is begun, when it is asked for."""
    items = {
        "far": {"mesh": "box.stl", "pose": AWAY},
        "open": {"mesh": "open.stl", "pose": POSE},
    }
    rig = bench(tmp_path / "bench", items=items, mounted="nothing")
    trimesh.Trimesh(BOX.vertices, BOX.faces[:-1]).export(rig.parent / "open.stl")
    for item, words in (("far", "correct 'items.far'"), ("open", "open.stl: is not watertight")):
        done = scan(fpplab, rig, "--item", item)
        assert done.code == 2
        assert words in done.json["error"]
    assert {path.name for path in tmp_path.iterdir()} == {"bench"}


@pytest.mark.whole
def test_a_part_of_ones_own_is_scanned_from_another_folder(fpplab: Command, tmp_path: Path) -> None:
    """Rig, world and part lie together; a cache that cannot be written is only told of."""
    rig = bench(tmp_path / "bench")
    (rig.parent / "cache").write_text("no folder")
    done = scan(fpplab, rig)
    assert done.code == 0, done.err
    assert "a table of light cannot be stored in" in done.err
    assert done.json["images"] == 6
    # The box covers 60 x 50 of a field of 172 x 115 mm, nearly all of it lit.
    assert 0.8 < done.json["points"] / (192 * 128 * 60 * 50 / (172 * 115)) < 1.1
    (rig.parent / "world.yaml").write_text("")
    again = scan(fpplab, rig)  # refused before the bench is opened, which would tell of the world
    assert again.code == 2
    assert f"{tmp_path / 's'}: exists already" in again.json["error"]
    assert "world" in scan(fpplab, rig, "--force").json["error"]
