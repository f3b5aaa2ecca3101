"""Scenes for data sets: any item before the simulated devices, and the ground truth of the scene."""

from dataclasses import replace
from typing import Annotated, Any, Protocol

import trimesh
from pydantic import Field

from fpplab.calibration.model import Calibration, PoseFile
from fpplab.core import config
from fpplab.core.config import Document
from sim.build import SceneState
from sim.items import item_poses, item_shape
from sim.light import Light
from sim.world import World

ITEM = "item"  # name of the one item of a scene


class DatasetScene(Document):
    """One scene as drawn: an artefact, or the board of a target file, with its paint, light and noise."""

    seed: int
    """Of the scene's noise."""
    artefact: str | None = None
    """Kind of the artefact; None for a board."""
    sizes: Annotated[dict[str, float | tuple[float, ...]], Field(default_factory=dict)]
    """Lengths of the artefact in mm, by name."""
    target: str | None = None
    """Target file of the board; None for an artefact."""
    pose: PoseFile
    """T_camera_item."""
    reflectance: float
    """Diffuse reflectance of the artefact, or of the board's ground."""
    ink: float
    """Diffuse reflectance of the board's print."""
    roughness: float
    """Roughness of the paint's matt body."""
    gloss: float
    """Share of the light that the gloss of the paint reflects."""
    gloss_roughness: float
    """Square root of the width of the gloss (GGX), from nearly a mirror to matt."""
    ambient: float
    """Even ambient light, relative to the projector's white."""
    charge: float
    """Electrons for the same grey level, relative to the rig's sensor."""
    read_noise_e: float
    """Read noise in electrons."""
    exposure_s: float
    """Exposure of the camera in s."""
    projector_blur: float
    """Standard deviation of the projector lens's point spread at its sharpest, in mirrors."""
    projector_focus_mm: float
    """Distance in focus of the projector in mm."""
    stage_mm: float
    """Position of the stage in mm."""


class WorldHolder(Protocol):
    """What a studio needs of the virtual bench whose scenes it arranges."""

    world: World
    """The world in use."""
    setup: SceneState
    """State of everything that moves."""
    light: Light
    """Pictures of the world in use."""

    def replace_world(self, world: World) -> None:
        """Go on with another world; called once for every scene."""


class SimStudio:
    """Scenes that are variations of the world in use when the studio is made."""

    def __init__(self, bench: WorldHolder) -> None:
        self._bench, self._nominal = bench, bench.world

    def nominal(self) -> dict[str, Any]:
        """Give the world that scenes are variations of."""
        return {name: part for name, part in config.plain(self._nominal).items() if name not in _REPLACED}

    def calibration(self, stage_mm: float) -> Calibration:
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
        return config.plain(self._bench.world)

    def truth(self) -> tuple[trimesh.Trimesh, Calibration]:
        """Give the true surface in the camera's frame (flat items have two sides), and the true devices."""
        world = self._bench.world
        vertices, faces = item_shape(world, ITEM)
        (pose,) = item_poses(world, ITEM)
        mesh = trimesh.Trimesh(pose.apply(vertices), faces, process=False)
        return mesh, self.calibration(self._bench.setup.stage_mm)


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
