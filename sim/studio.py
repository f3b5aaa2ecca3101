"""Scenes for data sets: any item before the simulated devices, and the ground truth of the scene."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import trimesh

from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.simulation.arrangeable import SceneTruth
from fpplab.simulation.scene import DatasetScene
from sim.build import Setup
from sim.items import item_poses, item_shape
from sim.light import Light
from sim.world import World

ITEM = "item"
"""Name of the one item of a scene."""


class WorldHolder(Protocol):
    """What a studio needs of the virtual bench whose scenes it arranges."""

    world: World
    """The world in use."""
    setup: Setup
    """State of everything that moves."""
    light: Light
    """Pictures of the world in use."""

    def replace_world(self, world: World) -> None:
        """Go on with another world; called once for every scene.

        Parameters
        ----------
        world : World
            With the scene's item, materials and light.
        """


class SimStudio:
    """A `fpplab.simulation.arrangeable.SceneStudio` over the world in use when it is made."""

    def __init__(self, bench: WorldHolder) -> None:
        self._bench, self._nominal = bench, bench.world

    def nominal(self) -> dict[str, Any]:
        """Give the world that scenes are variations of."""
        return {name: part for name, part in config.plain(self._nominal).items() if name not in _REPLACED}

    def calibration(self, stage_mm: float) -> Calibration:
        """Give the true devices."""
        world = self._nominal
        return Calibration(
            world.camera_model(), world.projector_model(), world.T_projector_camera(stage_mm), rms_px={}
        )

    def arrange(self, scene: DatasetScene) -> None:
        """Put the scene's item before the devices, in the scene's light."""
        self._bench.replace_world(_world_of(self._nominal, scene))
        self._bench.light.forget()  # no scene is used twice
        self._bench.setup = replace(self._bench.setup, item=ITEM, pose=0)

    def world(self) -> dict[str, Any]:
        """Give the world with the arranged scene."""
        return config.plain(self._bench.world)

    def truth(self) -> SceneTruth:
        """Give the ground truth of the arranged scene."""
        world = self._bench.world
        vertices, faces = item_shape(world, ITEM)
        (pose,) = item_poses(world, ITEM)
        mesh = trimesh.Trimesh(pose.apply(vertices), faces, process=False)
        return SceneTruth(mesh, self.calibration(self._bench.setup.stage_mm))


_REPLACED = ("seed", "items", "mounted", "material", "materials", "ambient")
"""Parts of a world that every scene replaces."""


def _world_of(nominal: World, scene: DatasetScene) -> World:
    """Make the nominal world with the scene in it; `ConfigError` where no world can have it."""
    data = nominal.model_dump(mode="json")
    pose = scene.pose.model_dump(mode="json")
    item: dict[str, Any]
    if scene.target is None:
        item = {"artefact": scene.artefact, "sizes": scene.sizes, "pose": pose}
    else:
        item = {
            "target": scene.target, "poses": [pose], "reflectance": scene.reflectance, "ink": scene.ink,
        }  # fmt: skip
    data |= {"seed": scene.seed, "ambient": scene.ambient, "items": {ITEM: item}, "mounted": ITEM}
    data["materials"] = {}
    data["material"] = {
        "kind": "glossy",
        **{n: getattr(scene, n) for n in ("reflectance", "roughness", "gloss", "gloss_roughness")},
    }
    sensor = nominal.camera.sensor
    data["camera"]["sensor"] |= {
        "full_well_e": scene.charge * sensor.full_well_e,
        "quantum_efficiency": scene.charge * sensor.quantum_efficiency,
        "read_noise_e": scene.read_noise_e,
    }
    data["projector"] |= {"blur": scene.projector_blur, "focus_mm": scene.projector_focus_mm}
    data["render"]["cache"] = False  # no scene is used twice
    return config.validate(data, World, "scene")
