"""The simulated world as plain data: the truth that a measurement on the twin is held against.

The world frame is the camera's (OpenCV, mm). Irradiance is relative: 1 is a perfectly white surface that
faces the white projector at `projector.distance_mm`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from fpplab import config
from fpplab.calibration import PoseFile
from fpplab.config import Document
from fpplab.conventions import Floats, Lattice
from fpplab.errors import ConfigError
from fpplab.geometry import Pinhole, RigidTransform
from sim.texture import LEAST_BLUR, MirrorTexture

Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Size = tuple[Annotated[int, Field(ge=8, le=20000)], Annotated[int, Field(ge=8, le=20000)]]
Binning = Literal[1, 2, 4, 8]
"""Pixels of the sensor along each side of a pixel of a frame."""
Small = Annotated[float, Field(ge=-0.5, le=0.5)]
Distortion = tuple[Small, Small, Small, Small, Small]


class Sensor(Document):
    """How light becomes numbers. Electrons are of the UNBINNED pixel; binning sums their charge.

    white_photons: photons on an unbinned pixel that sees irradiance 1 during `nominal_exposure_s`.
    read_noise_e: standard deviation, electrons. black_level: what no light gives, share of full scale.
    Full scale at 0 dB is the full well.
    """

    full_well_e: Positive = 15000.0
    read_noise_e: Annotated[float, Field(ge=0)] = 2.5
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)] = 0.6
    black_level: Annotated[float, Field(ge=0, lt=0.5)] = 0.01
    white_photons: Positive = 22000.0
    nominal_exposure_s: Positive = 0.02
    bits: Annotated[tuple[Literal[8, 12], ...], Field(min_length=1)] = (8, 12)
    exposure_s: tuple[Positive, Positive] = (20e-6, 10.0)
    gain_db: tuple[float, float] = (0.0, 24.0)


class CameraWorld(Document):
    """The camera. centre_offset_px: principal point minus the sensor's centre, in unbinned pixels."""

    sensor_size: Size = (5472, 3648)
    pixel_um: Positive = 2.4
    binning: Binning = 4
    focal_mm: Positive = 35.0
    centre_offset_px: tuple[float, float] = (0.0, 0.0)
    distortion: Distortion = (0.0,) * 5
    sensor: Sensor = Sensor()

    @model_validator(mode="after")
    def _binning_divides(self) -> CameraWorld:
        if any(side % self.binning for side in self.sensor_size):
            raise ValueError(
                f"'binning' is {self.binning}: it must divide the sensor's {list(self.sensor_size)}"
            )
        return self

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of a frame."""
        return self.sensor_size[0] // self.binning, self.sensor_size[1] // self.binning

    def model(self) -> Pinhole:
        """The camera of the binned pixels."""
        focal = self.focal_mm * 1000 / self.pixel_um / self.binning
        centre = tuple(
            (side / 2 + offset) / self.binning - 0.5
            for side, offset in zip(self.sensor_size, self.centre_offset_px, strict=True)
        )
        return Pinhole.from_focal(self.size, (focal, focal), (centre[0], centre[1]), self.distortion)


class Response(Document):
    """Light from grey levels, both 0 … 1: `I_out = a I_in^g + b`; b is what closed mirrors leak."""

    a: Annotated[float, Field(gt=0, le=1)] = 1.0
    b: Share = 0.0
    g: Annotated[float, Field(ge=0.2, le=5)] = 1.0

    @model_validator(mode="after")
    def _white_is_one_at_most(self) -> Response:
        if self.a + self.b > 1 + 1e-9:
            raise ValueError(
                f"'a' + 'b' is {self.a + self.b:g}: at most 1, which is the brightest the lamp gives"
            )
        return self


class ProjectorWorld(Document):
    """The projector.

    throw_ratio: distance over image width. centre_px: principal point; far from the image's middle on a lens
    that throws upwards. blur: standard deviation of the lens's point-spread, in mirrors.
    T_camera_projector: its pose in the camera's frame, with the stage at 0.
    distance_mm: where a facing white surface has irradiance 1.
    """

    size: Size = (912, 1140)
    lattice: Lattice = Lattice.DIAMOND
    throw_ratio: Positive = 1.2
    centre_px: tuple[float, float] = (455.5, 1110.0)
    distortion: Distortion = (0.0,) * 5
    T_camera_projector: PoseFile
    blur: Annotated[float, Field(ge=0, le=20)] = 0.6
    response: Response = Response()
    distance_mm: Positive = 475.0

    @model_validator(mode="after")
    def _blur_can_be_drawn(self) -> ProjectorWorld:
        if 0 < self.blur < LEAST_BLUR:
            raise ValueError(
                f"'blur' is {self.blur:g}: must be 0 (ideal mirrors) or at least {LEAST_BLUR:.3f}"
            )
        return self

    def model(self) -> Pinhole:
        """The projector's pinhole; on the diamond lattice rows lie half as far apart as columns."""
        focal = self.throw_ratio * self.size[0]
        along_rows = 2 * focal if self.lattice is Lattice.DIAMOND else focal
        return Pinhole.from_focal(
            self.size, (focal, along_rows), self.centre_px, self.distortion, self.lattice
        )

    def texture(self) -> MirrorTexture:
        """Its mirrors as a texture."""
        return MirrorTexture(self.size, self.lattice, self.blur)


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


class PoseRules(Document):
    """Seeded random poses of a board, wholly in the camera's image and the projector's light.

    tilt_deg: greatest angle between board and camera. distance_mm, range_mm: the centre's distance, middle
    and half range.
    """

    count: Annotated[int, Field(ge=1, le=500)] = 15
    tilt_deg: Annotated[float, Field(ge=0, le=60)] = 30.0
    distance_mm: Positive = 450.0
    range_mm: Annotated[float, Field(ge=0)] = 25.0
    turn_deg: Annotated[float, Field(ge=0, le=180)] = 10.0
    margin_px: Annotated[float, Field(ge=0)] = 4.0


class BoardItem(Document):
    """A characterisation board: its target file, and the poses it is held in."""

    target: str
    poses: PoseRules | tuple[PoseFile, ...] = PoseRules()


class ArtefactItem(Document):
    """An artefact of `fpplab.artefacts` by name, and its pose T_camera_item."""

    artefact: str
    pose: PoseFile


class CardItem(Document):
    """A plain plane of the world's paint. Its frame: origin in the middle, z away from the viewer."""

    card_mm: tuple[Positive, Positive]
    pose: PoseFile


def _kind_of_item(item: Any) -> str | None:
    keys = item if isinstance(item, dict) else type(item).model_fields
    return next((kind for kind in ("target", "artefact", "card_mm") if kind in keys), None)


Item = Annotated[
    Annotated[BoardItem, Tag("target")]
    | Annotated[ArtefactItem, Tag("artefact")]
    | Annotated[CardItem, Tag("card_mm")],
    Discriminator(
        _kind_of_item,
        custom_error_type="item",
        custom_error_message="must name a 'target', an 'artefact' or a 'card_mm'",
    ),
]


class Material(Document):
    """The paint of artefacts and cards: diffuse. Boards have the reflectance of their print."""

    reflectance: Share = 0.9


class Render(Document):
    """How pictures are made.

    path: `transport` (direct light, any pattern by table), `linear` (a basis of the loaded patterns),
    `reference` (every pattern rendered), or `auto`: transport without bounces, linear with them.
    subpixels: points of a pixel along each side. samples: light paths for each of them; more than one
    matters to bounced light alone. bounces: between surfaces.
    """

    path: Literal["auto", "transport", "linear", "reference"] = "auto"
    subpixels: Annotated[int, Field(ge=1, le=8)] = 2
    samples: Annotated[int, Field(ge=1, le=4096)] = 1
    bounces: Annotated[int, Field(ge=0, le=16)] = 0

    @model_validator(mode="after")
    def _path_can_serve(self) -> Render:
        if self.path == "transport" and self.bounces:
            raise ValueError(
                f"'path' is transport, which knows direct light alone, but 'bounces' is {self.bounces}: "
                "must be 0, or path linear or reference"
            )
        return self

    @property
    def shifts(self) -> list[tuple[float, float]]:
        """Where in a pixel to look, relative to its centre: the middles of equal squares, in px."""
        steps = (np.arange(self.subpixels) + 0.5) / self.subpixels - 0.5
        return [(float(u), float(v)) for v in steps for u in steps]


class World(Document):
    """The whole bench.

    items: what the fixture can hold, by name. mounted: what it holds at first. ambient: even light on
    everything in view.
    """

    seed: Annotated[int, Field(ge=0)] = 0
    camera: CameraWorld = CameraWorld()
    projector: ProjectorWorld
    stage: StageWorld = StageWorld()
    items: dict[str, Item]
    mounted: str = "nothing"
    material: Material = Material()
    ambient: Annotated[float, Field(ge=0, le=10)] = 0.0
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

    @classmethod
    def load(cls, path: Path | str) -> World:
        """Read a world file, by path or by the name of one that comes with fpplab. Raises `ConfigError`."""
        return config.load(config.find(path), cls)

    def binned(self, binning: Binning) -> World:
        """The same world, seen by its camera at another binning. Raises `ConfigError` when that cannot be."""
        data = self.model_dump(mode="json")
        data["camera"]["binning"] = binning
        return config.validate(data, World, "world")

    def camera_model(self) -> Pinhole:
        """The true camera."""
        return self.camera.model()

    def projector_model(self) -> Pinhole:
        """The true projector."""
        return self.projector.model()

    def T_projector_camera(self, stage_mm: float = 0.0) -> RigidTransform:
        """The true pose of the camera in the projector's frame, with the stage at `stage_mm`."""
        pose = self.projector.T_camera_projector.transform()
        return RigidTransform(pose.rotation, pose.translation + self.stage.offset(stage_mm)).inverse()

    def item(self, name: str) -> BoardItem | ArtefactItem | CardItem:
        """One item. Raises `ConfigError` that lists them."""
        if name not in self.items:
            raise ConfigError(f"world: there is no item '{name}'; there are {', '.join(self.items)}")
        return self.items[name]
