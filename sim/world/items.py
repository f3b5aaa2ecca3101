"""What the fixture of a world can hold: boards, artefacts, parts from files and plain cards."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag, model_validator

from fpplab.calibration.model import PoseFile
from fpplab.core import config
from fpplab.core.config import Document, Positive
from sim.world.numbers import NotNegative, Share

FileName = Annotated[str, Field(min_length=1)]


class PoseRules(Document):
    """Seeded random poses of a board, wholly in the camera's image and the projector's light."""

    count: Annotated[int, Field(ge=1, le=500)] = 15
    """Number of poses."""
    tilt_deg: Annotated[float, Field(ge=0, le=60)] = 30.0
    """Greatest angle between board and image plane, in degrees."""
    distance_mm: Positive = 450.0
    """Depth of the board's centre, middle of its range, in mm."""
    range_mm: NotNegative = 25.0
    """Half the range of the centre's depth, in mm."""
    turn_deg: Annotated[float, Field(ge=0, le=180)] = 10.0
    """Greatest rotation about the board's normal to either side, in degrees."""
    margin_px: NotNegative = 4.0
    """Least distance of the board from the edges of both images, in px."""


class BoardItem(Document):
    """A characterisation board and the poses it is held in. Its print is Lambertian."""

    target: FileName
    """Target file, by path or by the name of one that comes with fpplab."""
    reflectance: Share | None = None
    """Reflectance of the ground, 0 to 1, in place of the target file's."""
    ink: Share | None = None
    """Reflectance of what is printed, 0 to 1, in place of the target file's."""
    margins_mm: tuple[NotNegative, NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0, 0.0)
    """Width of the blank sheet beyond the target on the left, top, right and bottom, in mm."""
    rim_mm: NotNegative = 0.0
    """Width of a dark frame around the sheet, in mm, which hides and shades the surroundings."""
    rim_reflectance: Share = 0.0
    """Reflectance of the frame, 0 to 1; it is seen where the world has surroundings."""
    texture: FileName | None = None
    """Grey image over the sheet: factor by which its reflectance differs from place to place, 1 at 128."""
    poses: PoseRules | Annotated[tuple[PoseFile, ...], Field(min_length=1)] = PoseRules()
    """Poses T_camera_item, or rules for random ones."""

    @model_validator(mode="after")
    def _print_shows(self) -> BoardItem:
        if self.ink is not None and self.ink == self.reflectance:
            raise ValueError(f"'ink' is {self.ink:g}, as 'reflectance' is: must differ, or nothing shows")
        return self


class ArtefactItem(Document):
    """An artefact of `fpplab.artefacts`."""

    artefact: str
    """Name of the artefact."""
    sizes: Annotated[dict[str, Positive | tuple[Positive, ...]], Field(default_factory=dict)]
    """Lengths in mm by field, where they differ from the artefact's defaults."""
    pose: PoseFile
    """T_camera_item."""
    layer_mm: Positive | None = None
    """Layer height of a printer that slices it, in mm; None for the shape as designed."""
    bead_mm: NotNegative = 0.0
    """Depth of the grooves between the printer's layers, in mm."""
    material: str | None = None
    """Name in the world's `materials`; None for the world's `material`."""

    @model_validator(mode="after")
    def _beads_need_layers(self) -> ArtefactItem:
        if self.bead_mm and self.layer_mm is None:
            raise ValueError(f"'bead_mm' is {self.bead_mm:g} without 'layer_mm': beads are marks of layers")
        return self


class MeshItem(Document):
    """A watertight part from a file."""

    mesh: FileName
    """STL, PLY or OBJ file in mm."""
    pose: PoseFile
    """T_camera_item."""
    material: str | None = None
    """Name in the world's `materials`; None for the world's `material`."""


class CardItem(Document):
    """A plain rectangular card. Its frame: origin in the middle, z away from the viewer."""

    card_mm: tuple[Positive, Positive]
    """(width, height) in mm."""
    pose: PoseFile
    """T_camera_item."""
    material: str | None = None
    """Name in the world's `materials`; None for the world's `material`."""


AnyItem = BoardItem | ArtefactItem | MeshItem | CardItem


def with_file_beside(item: AnyItem, folder: Path) -> AnyItem:
    """Make the name of an item's file absolute, if there is a file of that name in a folder."""
    if isinstance(item, BoardItem):
        names = (
            {"target": item.target}
            if item.texture is None
            else {"target": item.target, "texture": item.texture}
        )
        return item.model_copy(
            update={key: config.resolve_relative_to(name, folder) for key, name in names.items()}
        )
    if isinstance(item, MeshItem):
        return item.model_copy(update={"mesh": config.resolve_relative_to(item.mesh, folder)})
    return item


_KINDS = ("target", "artefact", "mesh", "card_mm")


def _kind(item: Any) -> str | None:
    keys = item if isinstance(item, dict) else getattr(type(item), "model_fields", {})
    return next((f"with {kind}" for kind in _KINDS if kind in keys), None)  # tags must not look like keys


Item = Annotated[
    Annotated[BoardItem, Tag("with target")]
    | Annotated[ArtefactItem, Tag("with artefact")]
    | Annotated[MeshItem, Tag("with mesh")]
    | Annotated[CardItem, Tag("with card_mm")],
    Discriminator(
        _kind,
        custom_error_type="item",
        custom_error_message="must name a 'target', an 'artefact', a 'mesh' or a 'card_mm'",
    ),
]


class SurroundingsSection(Document):
    """Matt surfaces that stand still whatever the fixture holds, as a bench's recordings show them."""

    mesh: FileName
    """STL, PLY or OBJ file in mm in the camera's frame."""
    picture: FileName
    """Grey image of their reflectance as the camera sees it, from 0 to `reflectance` at white."""
    reflectance: Annotated[float, Field(gt=0, le=1)]
    """Reflectance of what is white in the picture, 0 to 1."""

    def beside(self, folder: Path) -> SurroundingsSection:
        """Make the names of files absolute that lie in a folder."""
        names = {
            name: config.resolve_relative_to(getattr(self, name), folder) for name in ("mesh", "picture")
        }
        return self.model_copy(update=names)

    def relative_to(self, folder: Path) -> SurroundingsSection:
        """Make the names of files relative that lie in a folder."""
        named = {name: Path(getattr(self, name)) for name in ("mesh", "picture")}
        inside = {name: path.name for name, path in named.items() if path.parent == folder.resolve()}
        return self.model_copy(update=inside)
