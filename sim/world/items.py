"""What the fixture of a world can hold."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag, model_validator

from fpplab.calibration.model import PoseFile
from fpplab.core import config
from fpplab.core.config import Document
from sim.world.numbers import NotNegative, Positive, Share

FileName = Annotated[str, Field(min_length=1)]


class PoseRules(Document):
    """Seeded random poses of a board, wholly in the camera's image and the projector's light.

    tilt_deg: greatest angle between board and camera. distance_mm, range_mm: the centre's distance, middle
    and half range.
    """

    count: Annotated[int, Field(ge=1, le=500)] = 15
    tilt_deg: Annotated[float, Field(ge=0, le=60)] = 30.0
    distance_mm: Positive = 450.0
    range_mm: NotNegative = 25.0
    turn_deg: Annotated[float, Field(ge=0, le=180)] = 10.0
    margin_px: NotNegative = 4.0


class BoardItem(Document):
    """A characterisation board: its target file, and the poses it is held in. Its print is Lambertian.

    reflectance, ink: of the ground and of what is printed on it, in place of the target file's.
    """

    target: FileName
    reflectance: Share | None = None
    ink: Share | None = None
    poses: PoseRules | Annotated[tuple[PoseFile, ...], Field(min_length=1)] = PoseRules()

    @model_validator(mode="after")
    def _print_shows(self) -> BoardItem:
        if self.ink is not None and self.ink == self.reflectance:
            raise ValueError(f"'ink' is {self.ink:g}, as 'reflectance' is: must differ, or nothing shows")
        return self


class ArtefactItem(Document):
    """An artefact of `fpplab.artefacts` by name, and its pose T_camera_item.

    sizes: its lengths in mm by field, where they are not the usual ones. layer_mm, bead_mm: as a printer
    slices it; without a layer it is as designed. material: by name.
    """

    artefact: str
    sizes: Annotated[dict[str, Positive | tuple[Positive, ...]], Field(default_factory=dict)]
    pose: PoseFile
    layer_mm: Positive | None = None
    bead_mm: NotNegative = 0.0
    material: str | None = None

    @model_validator(mode="after")
    def _beads_need_layers(self) -> ArtefactItem:
        if self.bead_mm and self.layer_mm is None:
            raise ValueError(f"'bead_mm' is {self.bead_mm:g} without 'layer_mm': beads are marks of layers")
        return self


class MeshItem(Document):
    """A watertight part from a file in mm (STL, PLY or OBJ), and its pose T_camera_item."""

    mesh: FileName
    pose: PoseFile
    material: str | None = None


class CardItem(Document):
    """A plain plane. Its frame: origin in the middle, z away from the viewer."""

    card_mm: tuple[Positive, Positive]
    pose: PoseFile
    material: str | None = None


AnyItem = BoardItem | ArtefactItem | MeshItem | CardItem


def with_file_beside(item: AnyItem, folder: Path) -> AnyItem:
    """The item with the name of its file made absolute, if there is one of that name in `folder`."""
    if isinstance(item, BoardItem):
        return item.model_copy(update={"target": config.resolve_beside(item.target, folder)})
    if isinstance(item, MeshItem):
        return item.model_copy(update={"mesh": config.resolve_beside(item.mesh, folder)})
    return item


_KINDS = ("target", "artefact", "mesh", "card_mm")


def _kind(item: Any) -> str | None:
    keys = item if isinstance(item, dict) else type(item).model_fields
    return next((f"with {kind}" for kind in _KINDS if kind in keys), None)  # not as any key is called


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
