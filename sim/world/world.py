"""The simulated world as a whole: the ground truth that measurements on the twin are compared with."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from fpplab.calibration.model import CalibrationFile
from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError
from fpplab.core.file_kinds import naming_other_kinds
from fpplab.core.files import write_text
from fpplab.core.geometry import Pinhole, RigidTransform, turned_towards
from sim.effects import EFFECTS, WorldEffects
from sim.world.camera import Binning, CameraWorld, has_rays
from sim.world.items import BoardItem, Item, SurroundingsSection, with_file_beside
from sim.world.materials import Material, MaterialSection
from sim.world.materials.diffuse import Diffuse
from sim.world.numbers import NotNegative
from sim.world.projector import ProjectorWorld
from sim.world.render import LightPath, Render

MAX_DRAWS = 1000  # how often a number is drawn until its field allows it (chosen)


class StageWorld(Document):
    """The linear stage that carries the projector."""

    travel_mm: tuple[float, float] = (-60.0, 60.0)
    """Least and greatest position, in mm; must contain 0."""
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)
    """Direction of travel in the camera's frame; of any length but zero."""

    @model_validator(mode="after")
    def _is_a_stage(self) -> StageWorld:
        if not self.travel_mm[0] <= 0 <= self.travel_mm[1]:
            raise ValueError(f"'travel_mm' is {list(self.travel_mm)}: must contain 0, where homing ends")
        if not np.any(self.axis):
            raise ValueError("'axis' is zero: must be a direction")
        return self

    def offset(self, position_mm: float) -> Floats:
        """Compute by how much the stage displaces the projector."""
        # returns (3,) mm
        axis = np.array(self.axis)
        return position_mm * axis / np.linalg.norm(axis)


class WorldContents(Document):
    """Devices, items and light of a world without effects."""

    seed: Annotated[int, Field(ge=0)] = 0
    """Of noise, vibration and random poses."""
    camera: CameraWorld = CameraWorld()
    """Sensor, shutter and lens."""
    projector: ProjectorWorld
    """Mirrors, lamp and lens."""
    calibration: CalibrationFile | None = None
    """Measured models of both devices and the pose between them with the stage at 0, in place of the
    `focal_mm`, `centre_offset_px`, `throw_ratio`, `centre_px`, `distortion` and `T_camera_projector` of
    `camera` and `projector`; a world file may name a calibration file. Apertures stay
    `focal_mm / f_number`."""
    stage: StageWorld = StageWorld()
    """The stage that carries the projector."""
    items: dict[str, Item]
    """What the fixture can hold, by name."""
    mounted: str = "nothing"
    """Item that the fixture holds at first."""
    standing: tuple[str, ...] = ()
    """Items that stand still in view in their first pose, such as reference marks."""
    material: MaterialSection = Diffuse()
    """Material of items that name none of `materials`."""
    materials: Annotated[dict[str, MaterialSection], Field(default_factory=dict)]
    """Further materials, by name."""
    surroundings: SurroundingsSection | None = None
    """What is seen and lit besides the items."""
    ambient: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Uniform ambient light on everything in view, relative to the projector's white."""


class World(WorldEffects, WorldContents):
    """A world file: devices, items, light and how pictures are rendered."""

    render: Render = Render()
    """How pictures are rendered."""
    uncertainty: Annotated[dict[str, NotNegative], Field(default_factory=dict)]
    """Standard uncertainties of numbers that were fitted to a bench, by path: `projector.blur`, say."""

    @model_validator(mode="after")
    def _names_are_free(self) -> World:
        if "nothing" in self.items:
            raise ValueError("'items' names an item 'nothing', which is the empty fixture's name")
        if self.mounted not in (*self.items, "nothing"):
            raise ValueError(
                f"'mounted' is '{self.mounted}': must be nothing, or one of {', '.join(self.items)}"
            )
        if other := [name for name in self.standing if name not in self.items]:
            raise ValueError(f"'standing' names '{other[0]}': must be of {', '.join(self.items)}")
        return self

    @model_validator(mode="after")
    def _materials_are_there(self) -> World:
        for name, item in self.items.items():
            material = None if isinstance(item, BoardItem) else item.material
            if material is not None and material not in self.materials:
                choices = ", ".join(self.materials) or "none"
                raise ValueError(
                    f"'items.{name}.material' is '{material}': must be of 'materials' ({choices})"
                )
        return self

    @model_validator(mode="after")
    def _standing_items_are_opaque(self) -> World:
        if translucent := [name for name in self.standing if self.is_translucent(name)]:
            raise ValueError(f"'standing' names '{translucent[0]}', which is translucent: must be opaque")
        return self

    @model_validator(mode="after")
    def _path_can_serve(self) -> World:
        if self.render.path == "transport" and (effect := self.indirect):
            raise ValueError(
                f"'render.path' is transport, which supports direct light only, but there is {effect}: "
                "choose path auto, linear or reference"
            )
        return self

    @model_validator(mode="after")
    def _calibration_fits(self) -> World:
        if self.calibration is None:
            return self
        calibration, lattice = self.calibration, self.projector.lattice
        for device, size in (("camera", self.camera.size), ("projector", self.projector.size)):
            calibrated_size = getattr(calibration, device).size
            if calibrated_size != size:
                raise ValueError(
                    f"'calibration' is for a {device} of {calibrated_size[0]} x {calibrated_size[1]}: "
                    f"must be {size[0]} x {size[1]} as the world's"
                )
        if calibration.projector.lattice is not lattice:
            raise ValueError(
                f"'calibration' is for a projector on a {calibration.projector.lattice} lattice: must be "
                f"{lattice} as the world's"
            )
        if not has_rays(self.camera_model()):
            raise ValueError(
                f"'calibration' has the camera distortion {list(calibration.camera.distortion)}: it folds or "
                "has a pole before the image's corner; must leave a ray to every pixel"
            )
        return self

    @model_validator(mode="after")
    def _uncertainty_is_of_numbers(self) -> World:
        for path in self.uncertainty:
            if self.number(path) is None:
                raise ValueError(
                    f"'uncertainty' names '{path}': must be the path of a number, such as projector.blur"
                )
        return self

    @property
    def moves_mm(self) -> float:
        """Size of the item's displacements by all effects: 0 where it stands still."""
        sizes = [effect.displacement_size_mm(self) for effect in EFFECTS]
        return math.hypot(*(size for size in sizes if size))

    @property
    def has_room_light(self) -> bool:
        """Whether there is light that is not the projector's."""
        lamps = [lamp for effect in EFFECTS for lamp in effect.point_lamps(self)]
        return self.ambient > 0 or any(lamp.irradiance > 0 for lamp in lamps)

    @property
    def indirect(self) -> str | None:
        """What makes light indirect, in words: bounces or a translucent item; None where all is direct."""
        if self.render.bounces:
            return f"interreflection ('render.bounces' is {self.render.bounces})"
        for name in self.items:
            if self.is_translucent(name):
                return f"a translucent material (of 'items.{name}')"
        return None

    def is_translucent(self, name: str) -> bool:
        return self.material_of(name).subsurface

    @property
    def path(self) -> LightPath:
        """The light path in use: the one chosen, or for `auto` the cheapest that is correct."""
        if self.render.path != "auto":
            return self.render.path
        return "linear" if self.indirect else "transport"

    @classmethod
    def load(cls, path: Path | str) -> World:
        # A relative name of a mesh, picture, target or calibration file is looked for next to the world file
        # first.
        file = config.find_config(path, "world")
        with naming_other_kinds(file, "world"):
            data = config.parse_yaml(config.read_text(file), file)
            if isinstance(data, dict) and isinstance(name := data.get("calibration"), str):
                measured = config.load_document(
                    config.find_config(config.resolve_relative_to(name, file.parent)),
                    CalibrationFile,
                    "calibration",
                )
                data["calibration"] = config.plain(measured)
            world = config.validate(data, cls, file)
        items = {name: with_file_beside(item, file.parent) for name, item in world.items.items()}
        around = world.surroundings and world.surroundings.beside(file.parent)
        return world.model_copy(update={"items": items, "surroundings": around})

    def save(self, folder: Path, name: str = "world.yaml") -> Path:
        """Write the world file, with a calibration next to it as `calibration.yaml`."""
        # Names of files stay as they are, except of targets that come with fpplab.
        data = config.plain(self)
        for item in data["items"].values():
            if "target" in item:
                item["target"] = config.portable_name(item["target"])
        if self.calibration is not None:
            write_text(folder / "calibration.yaml", config.dump(self.calibration))
            data["calibration"] = "calibration.yaml"
        write_text(folder / name, config.to_yaml(data))
        return folder / name

    def binned(self, binning: Binning) -> World:
        data = self.model_dump(mode="json")
        data["camera"]["binning"] = binning
        return config.validate(data, World, "world")

    def number(self, path: str) -> float | None:
        """Look up a number of the world's file."""
        value: Any = self
        for name in path.split("."):
            if isinstance(value, Document):
                value = getattr(value, name) if name in type(value).model_fields else None
            else:
                value = value.get(name) if isinstance(value, dict) else None
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None

    def drawn(self, draw: int) -> World:
        """Draw a world that this one could as well be, within its uncertainty."""
        # Each number is drawn by itself from a normal distribution, within the range that its field allows.
        world, random = self, np.random.default_rng(draw)
        for path, sigma in sorted(self.uncertainty.items()) if draw else ():
            for tried in range(MAX_DRAWS):
                data = section = world.model_dump(mode="json")
                *sections, name = path.split(".")
                for part in sections:
                    section = section[part]
                section[name] += sigma * float(random.standard_normal())
                try:
                    world = config.validate(data, World, "a draw of the world")
                    break
                except ConfigError:
                    if tried == MAX_DRAWS - 1:
                        raise
        return world

    def camera_model(self) -> Pinhole:
        return self.calibration.camera.model() if self.calibration else self.camera.model()

    def projector_model(self) -> Pinhole:
        return self.calibration.projector.model() if self.calibration else self.projector.model()

    def T_projector_camera(self, stage_mm: float = 0.0, convergence_deg: float = 0.0) -> RigidTransform:
        if self.calibration:
            pose = self.calibration.T_projector_camera.transform().inverse()
        else:
            pose = self.projector.T_camera_projector.transform()
        moved = pose.moved(self.stage.offset(stage_mm)).inverse()
        return turned_towards(moved, np.radians(convergence_deg)) if convergence_deg else moved

    def item(self, name: str) -> Item:
        if name not in self.items:
            raise ConfigError(f"world: there is no item '{name}'; there are {', '.join(self.items)}")
        return self.items[name]

    def material_of(self, name: str) -> Material:
        item = self.item(name)
        if isinstance(item, BoardItem):
            return Diffuse(reflectance=1.0)  # the print has its own reflectance
        return self.material if item.material is None else self.materials[item.material]
