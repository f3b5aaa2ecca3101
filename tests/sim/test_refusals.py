"""Impossible worlds are refused before any picture, with field, value and what is allowed."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from fpplab.core import config
from fpplab.core.errors import ConfigError
from fpplab.devices import State
from fpplab.devices.rig import Rig
from fpplab.targets import Target
from sim.bench import VirtualBench
from sim.devices import SimFixture
from sim.items import item_mesh, item_poses
from sim.light import Light, SceneState
from sim.world import MeshItem, World
from tests.sim.conftest import plain, world, write_world

CARD = plain()["items"]["card"]
POSE = {"rotation_deg": [180, 0, 0], "translation_mm": [0, 0, 460]}
AWAY = {"rotation_deg": [180, 0, 0], "translation_mm": [900, 0, 460]}


def sentence(error: BaseException) -> str:
    """The message, which is one sentence."""
    said = str(error)
    assert "\n" not in said
    assert len(said) < 500
    assert not said.endswith(".")
    return said


def projector(**fields: Any) -> dict[str, Any]:
    return {"projector": {**plain()["projector"], **fields}}


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "kind of material": (
        {"material": {"kind": "velvet"}},
        "'material' is {'kind': 'velvet'}: must have a 'kind' of diffuse, glossy, translucent",
    ),
    "kind of a named one": (
        {"materials": {"cloth": {"kind": "velvet"}}},
        "'materials.cloth' is {'kind': 'velvet'}: must have a 'kind' of diffuse, glossy, translucent",
    ),
    "field of a kind": (
        {"materials": {"paint": {"kind": "glossy", "gloss": 1.5}}},
        "'materials.paint.gloss' is 1.5: should be less than or equal to 1",
    ),
    "name of material": (
        {"items": {"card": {**CARD, "material": "wax"}}, "materials": {"chalk": {}, "soot": {}}},
        "'items.card.material' is 'wax': must be of 'materials' (chalk, soot)",
    ),
    "coefficients of a lens": (
        projector(distortion=[0.1, 0.0, 0.0, 0.0]),
        "'projector.distortion' is [0.1, 0.0, 0.0, 0.0]: must be 5 coefficients",
    ),
    "lens that folds": (
        {"camera": {**plain()["camera"], "focal_mm": 8, "distortion": [-0.5, 0.0, 0.0, 0.0, 0.0]}},
        "'distortion' is [-0.5, 0.0, 0.0, 0.0, 0.0]: it folds or has a pole before the image's corner",
    ),
    "path": (
        {"render": {"path": "magic"}},
        "'render.path' is 'magic': should be 'auto', 'transport', 'linear' or 'reference'",
    ),
    "transport with bounces": (
        {"render": {"path": "transport", "bounces": 2}},
        "'render.path' is transport, which supports direct light only, but there is interreflection "
        "('render.bounces' is 2): choose path auto, linear or reference",
    ),
    "transport through wax": (
        {
            "items": {"soft": {**CARD, "material": "wax"}},
            "materials": {"wax": {"kind": "translucent"}},
            "render": {"path": "transport"},
        },
        "there is a translucent material (of 'items.soft'): choose path auto, linear or reference",
    ),
    "device": (
        {"render": {"device": "TPU"}},
        "'render.device' is 'TPU': should be 'CPU', 'CUDA', 'OPTIX', 'HIP', 'METAL' or 'ONEAPI'",
    ),
    "colour": (
        projector(lit=["red"]),
        "in 'projector' 'lit' names 'red': must be of 'leds', which are green",
    ),
    "colour twice": (projector(lit=["green", "green"]), "'lit' names 'green' more than once"),
    "no colour": (projector(lit=[]), "'projector.lit' is []"),
    "ultraviolet": (
        projector(leds={"uv": {"lumens": 1.0, "wavelength_nm": 405}}, lit=["uv"]),
        "'projector.leds.uv.wavelength_nm' is 405: should be greater than or equal to 440",
    ),
    "focus in the lens": (
        {"camera": {"focus_mm": 20.0}},
        "in 'camera' 'focus_mm' is 20: must be greater than 'focal_mm', 35",
    ),
    "beads without layers": (
        {"items": {"part": {"artefact": "steps", "pose": POSE, "bead_mm": 0.05}}},
        "in 'items.part' 'bead_mm' is 0.05 without 'layer_mm'",
    ),
    "layers of a mesh": (
        {"items": {"part": {"mesh": "part.stl", "pose": POSE, "layer_mm": 0.2}}},
        "unknown key 'items.part.layer_mm'",
    ),
    "pose": ({"items": {"part": {"mesh": "part.stl"}}}, "'items.part.pose' is missing"),
    "no name of a mesh": ({"items": {"part": {"mesh": "", "pose": POSE}}}, "'items.part.mesh' is ''"),
    "no poses": ({"items": {"b": {"target": "target_paper.yaml", "poses": []}}}, "'items.b.poses' is []"),
    "two things at once": (
        {"items": {"part": {"mesh": "part.stl", "artefact": "steps", "pose": POSE}}},
        "unknown key 'items.part.mesh'",
    ),
    "mounted": ({"mounted": "cup"}, "'mounted' is 'cup': must be nothing, or one of card, pillars, board"),
    "vibration": ({"vibration_mm": -1.0}, "'vibration_mm' is -1.0: should be greater than or equal to 0"),
    "period": (
        projector(period_s=-0.1),
        "'projector.period_s' is -0.1: should be greater than or equal to 0",
    ),
    "line time": (
        {"camera": {"shutter": {"line_time_s": 1.0}}},
        "'camera.shutter.line_time_s' is 1.0: should be less than or equal to 0.01",
    ),
    "exposures": (
        {"camera": {"sensor": {"exposure_s": [1.0, 0.1]}}},
        "in 'camera.sensor' 'exposure_s' is [1.0, 0.1]: must be the minimum and the maximum",
    ),
    "gains": (
        {"camera": {"sensor": {"gain_db": [24.0, 0.0]}}},
        "in 'camera.sensor' 'gain_db' is [24.0, 0.0]: must be the minimum and the maximum",
    ),
}


@pytest.mark.parametrize(("changes", "said"), WRONG.values(), ids=WRONG.keys())
def test_a_wrong_field_is_named_with_what_is_allowed(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        world(**changes)
    assert said in sentence(caught.value)


# What is found when the bench opens ------------------------------------------------------------------


def opened(folder: Path, **changes: Any) -> ConfigError:
    """The virtual bench's message about a world; no process is left."""
    bench = VirtualBench({"world": write_world(folder, plain(**changes))})
    with pytest.raises(ConfigError) as caught:
        bench.open()
    assert bench.blender.pid is None
    return caught.value


def checked(folder: Path, item: str, **changes: Any) -> ConfigError:
    """The fixture's message about an item that it shall mount."""
    bench = VirtualBench({"world": write_world(folder, plain(**changes))})
    bench.open()
    with SimFixture("fixture", {}, bench) as fixture, pytest.raises(ConfigError) as caught:
        fixture.check(item)
    assert bench.setup.item == "nothing"
    assert bench.blender.pid is None
    return caught.value


@pytest.mark.whole
def test_a_device_that_is_not_there(tmp_path: Path) -> None:
    """Before anything is measured, although nothing is mounted yet."""
    said = sentence(opened(tmp_path, render={"device": "ONEAPI"}))
    world = tmp_path / "world.yaml"
    assert said.startswith(f"{world}: 'render.device' is ONEAPI, but there is no ONEAPI device")
    assert "set it to CPU, or install" in said


def test_an_item_out_of_the_camera_s_view(tmp_path: Path) -> None:
    items = {"pillars": {"artefact": "pillars", "pose": AWAY}}
    expected = (
        f"{tmp_path / 'world.yaml'}: the camera sees nothing of the projector's light on 'pillars' "
        "(pose 0, stage at 0 mm); "
        "correct 'items.pillars' or 'projector.T_camera_projector'"
    )
    assert sentence(opened(tmp_path, items=items, mounted="pillars")) == expected
    assert sentence(checked(tmp_path, "pillars", items=items)) == expected


def test_a_projector_that_looks_elsewhere(tmp_path: Path) -> None:
    turned = {"rotation_deg": [0, 90, 0], "translation_mm": [150, 0, 0]}
    said = sentence(opened(tmp_path, mounted="card", **projector(T_camera_projector=turned)))
    assert "'projector.T_camera_projector'" in said


def stl(mesh: trimesh.Trimesh) -> bytes:
    data = mesh.export(file_type="stl")
    assert isinstance(data, bytes)
    return data


BOX = trimesh.creation.box((40.0, 30.0, 20.0))
OPEN_BOX = trimesh.Trimesh(BOX.vertices, BOX.faces[:-1])
PARTS: dict[str, tuple[bytes | None, str]] = {
    "missing": (None, "there is no such file"),
    "open": (stl(OPEN_BOX), "is not watertight, for 3 open edges do not join two faces"),
    "inside out": (stl(trimesh.Trimesh(BOX.vertices, BOX.faces[:, ::-1])), "turn its faces outwards"),
    "metres": (stl(BOX.copy().apply_scale(0.001)), "looks like metres, for it is 0.04 mm large"),
    "empty": (b"", "part.stl"),
    "without faces": (bytes(84), "part.stl"),
    "text": (b"a shopping list\n" * 30, "part.stl"),
    "cut short": (stl(BOX)[:300], "part.stl"),
}


@pytest.mark.nightly
@pytest.mark.parametrize(("content", "why"), PARTS.values(), ids=PARTS.keys())
def test_a_file_that_is_no_part(tmp_path: Path, content: bytes | None, why: str) -> None:
    """At the start and on mounting; the message names the item's field and the file."""
    file = tmp_path / "part.stl"
    if content is not None:
        file.write_bytes(content)
    items = {"part": {"mesh": str(file), "pose": POSE}}
    for error in (opened(tmp_path, items=items, mounted="part"), checked(tmp_path, "part", items=items)):
        said = sentence(error)
        assert said.startswith(f"{tmp_path / 'world.yaml'}: 'items.part.mesh': {file}: ")
        assert why in said


@pytest.mark.parametrize(
    ("item", "said"),
    [
        ({"artefact": "vase"}, "'items.part.artefact': there is no artefact 'vase'; there are pyramid"),
        (
            {"artefact": "steps", "layer_mm": 0.2, "bead_mm": 0.1},
            "'items.part.artefact': bead_mm: 0.1 mm must be from 0 to less than half a layer, 0.1 mm",
        ),
        ({"artefact": "steps", "layer_mm": 60.0}, "'items.part.artefact': layer_mm: 60"),
    ],
)
def test_an_artefact_that_cannot_be_made(tmp_path: Path, item: dict[str, Any], said: str) -> None:
    assert said in sentence(opened(tmp_path, items={"part": {**item, "pose": POSE}}, mounted="part"))


def test_a_target_that_is_not_there(tmp_path: Path) -> None:
    items = {"board": {"target": "target_none.yaml", "poses": [POSE]}}
    said = sentence(opened(tmp_path, items=items, mounted="board"))
    world = tmp_path / "world.yaml"
    assert said.startswith(f"{world}: 'items.board.target': target_none.yaml: there is no such file")


# Files beside the world ------------------------------------------------------------------------------


def moved_away(folder: Path, **items: Any) -> Path:
    """A world file in a folder of its own, with a part and a target beside it."""
    (folder / "parts").mkdir(parents=True)
    (folder / "parts" / "box.stl").write_bytes(stl(BOX))
    target = config.load_document(config.find_config("target_paper.yaml"), Target)
    (folder / "mine.yaml").write_text(config.dump(target.model_copy(update={"size_mm": (90.0, 70.0)})))
    return Path(write_world(folder, plain(items=items)))


def test_files_are_found_beside_the_world_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent of the working directory and of files of that name in it."""
    part, board = {"mesh": "parts/box.stl", "pose": POSE}, {"target": "mine.yaml", "poses": [POSE]}
    path = moved_away(tmp_path / "bench", part=part, board=board)
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "box.stl").write_bytes(b"another")
    monkeypatch.chdir(tmp_path)
    of = World.load(path.relative_to(tmp_path))
    monkeypatch.chdir("/")
    assert isinstance(of.items["part"], MeshItem)
    assert item_mesh(of.items["part"]).volume == pytest.approx(24000)
    assert Target.load(of.items["board"].target).size_mm == (90.0, 70.0)  # type: ignore[union-attr]
    assert of.binned(2).items == of.items


def test_a_target_that_comes_with_fpplab_is_still_found(tmp_path: Path) -> None:
    path = moved_away(tmp_path / "bench", board={"target": "target_paper.yaml", "poses": [POSE]})
    assert len(item_poses(World.load(path), "board")) == 1


def test_a_rig_a_world_and_a_part_in_one_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "bench"
    moved_away(folder, part={"mesh": "parts/box.stl", "pose": POSE})
    sections: dict[str, Any] = {
        name: {"backend": f"sim.devices:Sim{name.title()}"} for name in ("camera", "projector", "fixture")
    }
    bench = {"backend": "sim.devices:VirtualBench", "world": "world.yaml"}
    (folder / "rig.yaml").write_text(config.to_yaml({"name": "Mine", "bench": bench, **sections}))
    monkeypatch.chdir("/")
    with Rig.load(folder / "rig.yaml") as rig:
        rig.need_fixture("a test").check("part")
        rig.need_fixture("a test").mount("part")
    assert rig.camera.state is State.CLOSED


@pytest.mark.whole
def test_a_part_that_has_changed_is_read_again(tmp_path: Path) -> None:
    file = tmp_path / "part.stl"
    item = MeshItem.model_validate_json(f'{{"mesh": "{file}", "pose": {json.dumps(POSE)}}}')
    file.write_bytes(stl(BOX))
    assert item_mesh(item).volume == pytest.approx(24000)
    file.write_bytes(stl(BOX.copy().apply_scale(2.0)))
    os.utime(file, (1, 1))
    assert item_mesh(item).volume == pytest.approx(8 * 24000)


# The camera where no shader of ours runs -------------------------------------------------------------

WITHOUT_SHADERS = """
import sim.blender.scene as scene
from sim.blender.server import main
scene.runs_osl = lambda device: False
main()
"""


@pytest.fixture(scope="module")
def without_shaders() -> Iterator[Any]:
    """A Blender process that renders on the CPU as it would on a device that runs no shaders of ours."""
    from sim.worker import Blender

    start = subprocess.Popen
    blender = Blender("plain")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "sim.worker.subprocess.Popen",
            lambda command, **options: start([sys.executable, "-P", "-c", WITHOUT_SHADERS], **options),
        )
        blender.start()
    yield blender
    blender.close()


def straight(**fields: Any) -> dict[str, Any]:
    return {"camera": {**plain()["camera"], "distortion": [0.0] * 5, **fields}}


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("size", [(192, 128), (96, 144), (100, 100)])
def test_the_camera_without_shaders_sees_the_same(
    blender: Any, without_shaders: Any, size: tuple[int, int]
) -> None:
    """Points of pillars that either camera sees, with its centre off the middle and four rays a pixel."""
    of = world(
        render={"subpixels": 2, "cache": False}, **straight(sensor_size=size, centre_offset_px=[9.3, -6.7])
    )
    ours, plain_one = (
        Light(of, process).table(SceneState("card")).samples for process in (blender, without_shaders)
    )
    assert ours[..., 3].min() > 0.1
    assert np.ptp(ours[..., 0]) > 100
    np.testing.assert_allclose(plain_one[..., :2], ours[..., :2], atol=0.02)
    np.testing.assert_allclose(plain_one[..., 3], ours[..., 3], rtol=1e-4)


@pytest.mark.parametrize("fields", [{"distortion": [-0.1, 0, 0, 0, 0]}, {"focus_mm": 450.0}])
def test_the_camera_without_shaders_refuses_what_it_cannot(
    without_shaders: Any, fields: dict[str, Any]
) -> None:
    of = world(render={"cache": False}, **straight(**fields))
    with pytest.raises(ConfigError) as caught:
        Light(of, without_shaders).table(SceneState("card"))
    said = sentence(caught.value)
    assert "choose one of them as 'render.device', or set distortion to zeros and leave out focus_mm" in said
    assert without_shaders.pid is not None, "a refusal is no fault"
