"""Reference marks as they were seen when a rig was characterised, kept with the calibration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from fpplab.core.config import Document
from fpplab.core.conventions import Floats


@dataclass(frozen=True, eq=False)
class LocatedMarks:
    """Points of reference marks, seen by camera and projector at the time of a characterisation."""

    target: dict[str, Any]  # content of the target file
    ids: NDArray[np.intp]  # (K,) rows of `Target.points`
    camera_px: Floats  # (K, 2) image coordinates (u, v) in px
    projector_px: Floats  # (K, 2) projector coordinates (u, v) in px


Pixel = tuple[float, float]


class LocatedMarksFile(Document):
    """Reference marks in a calibration file."""

    target: dict[str, Any]
    """Content of the target file."""
    ids: tuple[Annotated[int, Field(ge=0)], ...]
    """Which of the target's points were seen."""
    camera_px: tuple[Pixel, ...]
    """Where the camera saw each of them, in px."""
    projector_px: tuple[Pixel, ...]
    """Coordinates of the projector there, in px."""

    @model_validator(mode="after")
    def _has_a_place_for_each(self) -> LocatedMarksFile:
        if not len(self.ids) == len(self.camera_px) == len(self.projector_px):
            raise ValueError("'ids', 'camera_px' and 'projector_px' must have as many entries")
        if not np.isfinite([*self.camera_px, *self.projector_px]).all():
            raise ValueError("'camera_px' and 'projector_px' must be finite")
        return self

    @classmethod
    def of(cls, marks: LocatedMarks) -> LocatedMarksFile:
        camera, projector = (
            tuple((u, v) for u, v in np.round(pixels, 5).tolist())
            for pixels in (marks.camera_px, marks.projector_px)
        )
        return cls(
            target=marks.target, ids=tuple(marks.ids.tolist()), camera_px=camera, projector_px=projector
        )

    def marks(self) -> LocatedMarks:
        camera, projector = (
            np.array(pixels, float).reshape(-1, 2) for pixels in (self.camera_px, self.projector_px)
        )
        return LocatedMarks(self.target, np.array(self.ids, np.intp), camera, projector)
