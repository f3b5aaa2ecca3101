"""Small worlds, and what the camera sees of them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern, uniform_patterns
from sim.bench import VirtualBench
from sim.devices import SimCamera, SimFixture, SimProjector, SimStage
from sim.light import Light, PatternLevels, SceneState, ShownPattern
from sim.light.table import LightTable
from sim.worker import Blender
from sim.world import World

SIZE = (192, 128)
RIG = """
name: small virtual bench
bench: {backend: "sim.devices:VirtualBench", world: world.yaml}
camera: {backend: "sim.devices:SimCamera", bits: 12}
projector: {backend: "sim.devices:SimProjector"}
fixture: {backend: "sim.devices:SimFixture"}
"""
"""A rig file that stands beside the file of `write_world`."""
OTHER_MATERIALS: tuple[dict[str, Any], ...] = (
    {"roughness": 0.3},
    {"kind": "glossy"},
    {"kind": "translucent"},
    {"ridges": {"depth_mm": 0.1}},
    {"grain": {"slope": 0.1}},
)
"""Changes of a material after which light on it is not traced: it is not evenly matt."""


def plain(**changes: Any) -> dict[str, Any]:
    """The demonstration's world with few pixels, as plain data; `changes` replace fields of sections."""
    data: dict[str, Any] = {
        "seed": 7,
        "camera": {
            "sensor_size": SIZE,
            "pixel_um": 13132.8 / SIZE[0],
            "binning": 1,
            "focal_mm": 35,
            "centre_offset_px": [1.5, -0.75],
            "distortion": [-0.2, 0.3, 0.001, -0.002, 0.05],
        },
        "projector": {
            "distortion": [-0.05, 0.08, 0.0004, 0.0006, 0.01],
            "T_camera_projector": {"rotation_deg": [-13.8, -18.1, 2.2], "translation_mm": [150, 0, 0]},
            "response": {"a": 1.0, "b": 0.0, "g": 1.0},
            # Dim, because such great pixels gather 800 times the light.
            "leds": {"green": {"lumens": 0.15, "wavelength_nm": 525}},
        },
        "items": {
            "card": {
                "card_mm": [300, 240],
                "pose": {"rotation_deg": [8, -5, 0], "translation_mm": [0, 0, 450]},
            },
            "pillars": {
                "artefact": "pillars",
                "pose": {"rotation_deg": [180, 0, 0], "translation_mm": [0, 0, 460]},
            },
            "board": {"target": "target_paper.yaml", "poses": {"count": 4}},
        },
        "render": {"subpixels": 1},
    }
    for section, fields in changes.items():
        data[section] = {**data.get(section, {}), **fields} if isinstance(fields, dict) else fields
    return data


def world(**changes: Any) -> World:
    """`plain` as a world."""
    return config.validate(plain(**changes), World, "test world")


def write_world(folder: Path, data: dict[str, Any]) -> str:
    """A world file; its name."""
    path = folder / "world.yaml"
    path.write_text(
        config.to_yaml(
            {**data, "camera": {**data["camera"], "sensor_size": list(data["camera"]["sensor_size"])}}
        )
    )
    return str(path)


class Bench:
    """The whole rig, open."""

    def __init__(self, file: str) -> None:
        self.shared = VirtualBench({"world": file})
        self.camera = SimCamera("camera", {}, self.shared)
        self.projector = SimProjector("projector", {}, self.shared)
        self.stage = SimStage("stage", {}, self.shared)
        self.fixture = SimFixture("fixture", {}, self.shared)

    def open(self) -> None:
        self.shared.open()
        for device in (self.camera, self.projector, self.stage, self.fixture):
            device.open()
        self.camera.configure(CameraSettings(0.02, bits=12))
        self.projector.load(uniform_patterns([0, 128, 255], self.projector.caps.size))

    def close(self) -> None:
        for device in (self.camera, self.projector, self.stage, self.fixture):
            device.close()
        self.shared.close()


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """An empty cache directory of this run's own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """One virtual bench for the tests of a module, of the world `plain`."""
    rig = Bench(write_world(tmp_path_factory.mktemp("world"), plain()))
    rig.open()
    yield rig
    rig.close()


def levels(function: Any, of: World) -> Pattern:
    """A pattern from a function of the mirrors' (u, v) that gives levels in [0, 1]."""
    from fpplab.core.conventions import mirror_centres
    from fpplab.patterns.fringes import quantise

    u, v = mirror_centres(of.projector.size, of.projector.lattice)
    return Pattern("test", quantise(np.broadcast_to(np.asarray(function(u, v), np.float64), u.shape)))


def seen(blender: Blender, of: World, setup: SceneState, *patterns: Pattern) -> list[PatternLevels]:
    """What the camera sees of `setup` under each pattern."""
    light = Light(of, blender)
    return [light.irradiance(setup, ShownPattern(patterns, i)) for i in range(len(patterns))]


def card_points(of: World, pixels: Floats) -> Floats:
    """Points (..., 3) of the card in the camera's frame that the true camera sees at pixels (..., 2)."""
    item = of.items["card"]
    pose = item.pose.transform()  # type: ignore[union-attr]
    rays = np.concatenate([of.camera_model().normalise(pixels), np.ones((*pixels.shape[:-1], 1))], axis=-1)
    normal = pose.rotation[:, 2]
    depth = normal @ pose.translation / (rays @ normal)
    return np.asarray(rays * depth[..., None])


def grid(of: World) -> Floats:
    """Every pixel (height, width, 2)."""
    width, height = of.camera.size
    v, u = np.mgrid[0:height, 0:width].astype(np.float64)
    return np.stack([u, v], axis=-1)


def samples_of_image(table: LightTable) -> PatternLevels:
    """A table's samples (K, height, width, 4) for the whole image, zeros where it has none."""
    views, h, w, channels = table.samples.shape
    (left, top), samples = table.corner, np.zeros((views, *table.albedo.shape, channels), np.float32)
    samples[:, top : top + h, left : left + w] = table.samples
    return samples
