"""The whole simulated bench: the truth that a measurement on the twin is held against."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from fpplab.calibration.model import CalibrationFile
from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError
from fpplab.core.files import write_text
from fpplab.core.geometry import Pinhole, RigidTransform, turned_towards
from sim.world.camera import Binning, CameraWorld, has_rays
from sim.world.items import BoardItem, Item, with_file_beside
from sim.world.materials import Material, MaterialSection
from sim.world.materials.diffuse import Diffuse
from sim.world.numbers import NotNegative
from sim.world.projector import ProjectorWorld
from sim.world.render import LightPath, Render


class StageWorld(Document):
    """The stage that carries the projector along `axis`, a direction in the camera's frame."""

    travel_mm: tuple[float, float] = (-60.0, 60.0)
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _is_a_stage(self) -> StageWorld:
        if not self.travel_mm[0] <= 0 <= self.travel_mm[1]:
            raise ValueError(f"'travel_mm' is {list(self.travel_mm)}: must hold 0, where homing ends")
        if not np.any(self.axis):
            raise ValueError("'axis' is zero: must be a direction")
        return self

    def offset(self, position_mm: float) -> Floats:
        """How far the stage carries the projector, (3,) in mm in the camera's frame."""
        axis = np.array(self.axis)
        return position_mm * axis / np.linalg.norm(axis)


class World(Document):
    """The whole bench.

    calibration: measured models of both devices and the pose between them with the stage at 0, in place of
    the `focal_mm`, `centre_offset_px`, `throw_ratio`, `centre_px`, `distortion` and `T_camera_projector` of
    `camera` and `projector`; a world file may name a calibration file. Apertures stay `focal_mm / f_number`.
    items: what the fixture can hold, by name. mounted: what it holds at first. material: of items that name
    none of `materials`. ambient: even light on everything in view, relative to the projector's white.
    vibration_mm: standard deviation, along each axis, of where the item is from frame to frame.
    """

    seed: Annotated[int, Field(ge=0)] = 0
    camera: CameraWorld = CameraWorld()
    projector: ProjectorWorld
    calibration: CalibrationFile | None = None
    stage: StageWorld = StageWorld()
    items: dict[str, Item]
    mounted: str = "nothing"
    material: MaterialSection = Diffuse()
    materials: Annotated[dict[str, MaterialSection], Field(default_factory=dict)]
    ambient: Annotated[float, Field(ge=0, le=10)] = 0.0
    vibration_mm: Annotated[NotNegative, Field(le=10)] = 0.0
    render: Render = Render()

    @model_validator(mode="after")
    def _names_are_free(self) -> World:
        if "nothing" in self.items:
            raise ValueError("'items' names an item 'nothing', which is the empty fixture's name")
        if self.mounted not in (*self.items, "nothing"):
            raise ValueError(
                f"'mounted' is '{self.mounted}': must be nothing, or one of {', '.join(self.items)}"
            )
        return self

    @model_validator(mode="after")
    def _materials_are_there(self) -> World:
        for name, item in self.items.items():
            wanted = None if isinstance(item, BoardItem) else item.material
            if wanted is not None and wanted not in self.materials:
                known = ", ".join(self.materials) or "none"
                raise ValueError(f"'items.{name}.material' is '{wanted}': must be of 'materials' ({known})")
        return self

    @model_validator(mode="after")
    def _path_can_serve(self) -> World:
        if self.render.path == "transport" and (effect := self.indirect):
            raise ValueError(
                f"'render.path' is transport, which knows direct light alone, but there is {effect}: "
                "choose path auto, linear or reference"
            )
        return self

    @model_validator(mode="after")
    def _calibration_fits(self) -> World:
        if self.calibration is None:
            return self
        given, lattice = self.calibration, self.projector.lattice
        for device, size in (("camera", self.camera.size), ("projector", self.projector.size)):
            found = getattr(given, device).size
            if found != size:
                raise ValueError(
                    f"'calibration' is for a {device} of {found[0]} x {found[1]}: must be {size[0]} x "
                    f"{size[1]} as the world's"
                )
        if given.projector.lattice is not lattice:
            raise ValueError(
                f"'calibration' is for a projector on a {given.projector.lattice} lattice: must be "
                f"{lattice} as the world's"
            )
        if not has_rays(self.camera_model()):
            raise ValueError(
                f"'calibration' has the camera distortion {list(given.camera.distortion)}: it folds or has "
                "a pole before the image's corner; must leave a ray to every pixel"
            )
        return self

    @property
    def indirect(self) -> str | None:
        """What makes light arrive elsewhere than where it fell, if anything does."""
        if self.render.bounces:
            return f"light that bounces ('render.bounces' is {self.render.bounces})"
        for name in self.items:
            if self.is_translucent(name):
                return f"a translucent material (of 'items.{name}')"
        return None

    def is_translucent(self, name: str) -> bool:
        """Whether light enters an item and leaves it elsewhere."""
        return self.material_of(name).subsurface

    @property
    def path(self) -> LightPath:
        """The way that serves: as chosen, or for `auto` the cheapest that is right."""
        if self.render.path != "auto":
            return self.render.path
        return "linear" if self.indirect else "transport"

    @classmethod
    def load(cls, path: Path | str) -> World:
        """Read a world file, by path or by the name of one that comes with fpplab. Raises `ConfigError`.

        A relative name of a mesh, target or calibration file is looked for beside the world file first.
        """
        found = config.find_config(path)
        data = config.parse_yaml(config.read_text(found), found)
        if isinstance(data, dict) and isinstance(name := data.get("calibration"), str):
            measured = config.load_document(
                config.find_config(config.resolve_beside(name, found.parent)), CalibrationFile
            )
            data["calibration"] = config.plain(measured)
        world = config.validate(data, cls, found)
        items = {name: with_file_beside(item, found.parent) for name, item in world.items.items()}
        return world.model_copy(update={"items": items})

    def save(self, folder: Path, name: str = "world.yaml") -> Path:
        """Write as a world file in `folder`, a calibration beside it as `calibration.yaml`; its path.

        Names of mesh and target files stay as they are. Raises `DataError` when the place cannot be written.
        """
        data = config.plain(self)
        if self.calibration is not None:
            write_text(folder / "calibration.yaml", config.dump(self.calibration))
            data["calibration"] = "calibration.yaml"
        write_text(folder / name, config.to_yaml(data))
        return folder / name

    def binned(self, binning: Binning) -> World:
        """The same world, seen by its camera at another binning. Raises `ConfigError` when that cannot be."""
        data = self.model_dump(mode="json")
        data["camera"]["binning"] = binning
        return config.validate(data, World, "world")

    def camera_model(self) -> Pinhole:
        """The true camera."""
        return self.calibration.camera.model() if self.calibration else self.camera.model()

    def projector_model(self) -> Pinhole:
        """The true projector."""
        return self.calibration.projector.model() if self.calibration else self.projector.model()

    def T_projector_camera(self, stage_mm: float = 0.0, convergence_deg: float = 0.0) -> RigidTransform:
        """The true pose of the camera in the projector's frame, with the stage at `stage_mm`.

        convergence_deg: turn of the projector there towards the camera, see `turned_towards`.
        """
        if self.calibration:
            pose = self.calibration.T_projector_camera.transform().inverse()
        else:
            pose = self.projector.T_camera_projector.transform()
        moved = pose.moved(self.stage.offset(stage_mm)).inverse()
        return turned_towards(moved, np.radians(convergence_deg)) if convergence_deg else moved

    def item(self, name: str) -> Item:
        """One item. Raises `ConfigError` that lists them."""
        if name not in self.items:
            raise ConfigError(f"world: there is no item '{name}'; there are {', '.join(self.items)}")
        return self.items[name]

    def material_of(self, name: str) -> Material:
        """What an item is made of; the white of a board's print for a board."""
        item = self.item(name)
        if isinstance(item, BoardItem):
            return Diffuse(reflectance=1.0)  # a print has its own reflectance
        return self.material if item.material is None else self.materials[item.material]
