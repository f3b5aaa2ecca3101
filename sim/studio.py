"""The bench as a studio for data sets: any scene of its devices, and what is true of it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import trimesh

from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.simulation.arrangeable import SceneTruth
from fpplab.simulation.scene import DatasetScene
from sim.items import item_poses, item_shape
from sim.world import World

if TYPE_CHECKING:
    from sim.devices import VirtualBench

ITEM = "item"
"""What a scene's one item is called."""


class SimStudio:
    """A `fpplab.simulation.arrangeable.Arrangeable` of the world that the bench stands in when it is made."""

    def __init__(self, bench: VirtualBench) -> None:
        self._bench, self._nominal = bench, bench.world

    def nominal(self) -> dict[str, Any]:
        """The world that scenes are variations of, without its items, which do not appear in them."""
        return {name: part for name, part in config.plain(self._nominal).items() if name not in _REPLACED}

    def calibration(self, stage_mm: float) -> Calibration:
        """The true devices with the stage at `stage_mm`."""
        world = self._nominal
        return Calibration(
            world.camera_model(), world.projector_model(), world.T_projector_camera(stage_mm), rms_px={}
        )

    def arrange(self, scene: DatasetScene) -> None:
        """Stand the scene's item before the devices, in its light. Raises `ConfigError`."""
        self._bench.become(_world_of(self._nominal, scene))
        self._bench.light.forget()  # no scene comes again
        self._bench.setup = replace(self._bench.setup, item=ITEM, pose=0)

    def world(self) -> dict[str, Any]:
        """The world as it is arranged."""
        return config.plain(self._bench.world)

    def truth(self) -> SceneTruth:
        """The item's true surface, and the devices where the stage has put them."""
        world = self._bench.world
        vertices, faces = item_shape(world, ITEM)
        (pose,) = item_poses(world, ITEM)
        mesh = trimesh.Trimesh(pose.apply(vertices), faces, process=False)
        return SceneTruth(mesh, self.calibration(self._bench.setup.stage_mm))


_REPLACED = ("seed", "items", "mounted", "material", "materials", "ambient")
"""Parts of a world that every scene has its own of."""


def _world_of(nominal: World, scene: DatasetScene) -> World:
    """The nominal world with the scene in it. Raises `ConfigError` for what no world can have."""
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
    data["render"]["cache"] = False  # no scene comes again
    return config.validate(data, World, "scene")
