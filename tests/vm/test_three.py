"""A display projector, a camera behind the kernel's UVC driver and a stage measure a virtual scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fpplab.acquisition.acquire import capture
from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.reconstruction.points import points_of
from sim.items import item_poses
from sim.world import World
from tests.drivers.screen_scene import write_scene
from tests.vm.uvc_descriptors import HEIGHT, WIDTH

PLAN = Plan(
    fringes=(Sinusoid(axis="x", stripes=1, steps=6), Sinusoid(axis="x", stripes=8, steps=6)), exposure_s=0.02
)
PLACES_MM = (0.0, 15.0)
"""Of the stage, which carries the projector."""


@pytest.fixture
def scene(tmp_path: Path) -> World:
    """The scene of the whole commands for the few pixels of the USB camera, with a stage."""
    write_scene(tmp_path)
    world = config.parse_yaml((tmp_path / "world.yaml").read_text(), "world")
    world["camera"] |= {"sensor_size": [WIDTH, HEIGHT], "pixel_um": 273.6}
    world["projector"]["leds"]["green"]["lumens"] = 0.004
    del world["items"]["board"]
    world["stage"] = {"travel_mm": [0, 40], "axis": [1, 0, 0]}
    optics = config.parse_yaml((tmp_path / "optics.yaml").read_text(), "optics")
    optics["camera"]["bits"] = 12
    del optics["fixture"]
    optics["stage"] = {"backend": "sim.devices:SimStage"}
    rig = config.parse_yaml((Path(__file__).parent / "rig_three.yaml").read_text(), "rig")
    rig["bench"]["optics"] = "optics.yaml"
    for name, document in (("world", world), ("optics", optics), ("rig", rig)):
        (tmp_path / f"{name}.yaml").write_text(config.to_yaml(document))
    return World.load(tmp_path / "world.yaml")


def rms_mm(frames: list[np.ndarray], world: World, stage_mm: float) -> float:
    """Distance of the points from the card that is really there."""
    recording = Recording(frames, PLAN, world.projector.size, 12, "scene")
    place = world.T_projector_camera(stage_mm)
    true = Calibration(world.camera_model(), world.projector_model(), place, {})
    _, cloud = points_of(decode(recording), true, PLAN)
    assert len(cloud.points) > 0.8 * WIDTH * HEIGHT
    pose = item_poses(world, "grey_card")[0]
    return float(np.sqrt(np.mean(((cloud.points - pose.translation) @ pose.rotation[:, 2]) ** 2)))


def test_a_card_is_where_it_is_from_wherever_the_stage_stands(scene: World, tmp_path: Path) -> None:
    with Rig.load(tmp_path / "rig.yaml") as rig:
        assert rig.stage is not None
        rig.stage.home()
        for place_mm in PLACES_MM:
            assert rig.stage.move_to(place_mm) == pytest.approx(place_mm, abs=0.01)
            frames = capture(rig, PLAN)
            errors = {other: rms_mm(frames, scene, other) for other in PLACES_MM}
            print(f"stage at {place_mm:g} mm: RMS from the true card {errors[place_mm]:.3f} mm")
            assert errors[place_mm] < 0.5
            assert all(error > 5.0 for other, error in errors.items() if other != place_mm)
