"""What a characterisation found out about its board and its own errors, kept with the calibration.

With it other poses of the same board can be judged: which errors are to be expected in them is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from fpplab.core.config import Document
from fpplab.core.conventions import Floats

Size = Annotated[float, Field(ge=0, le=1e3)]


class FittedErrors(Document):
    """Standard deviations of the errors that a characterisation found."""

    camera_px: Annotated[float, Field(gt=0, le=1e3)]
    """Of a coordinate of a point detected in the camera's image, in px."""
    projector_px: Annotated[float, Field(gt=0, le=1e3)]
    """Of a projector coordinate read there, in px of the projector, beyond what is carried into it."""
    camera_shared_px: Size = 0.0
    """Of each smooth function over the board that the errors of one pose share in the camera, in px."""
    projector_shared_px: Size = 0.0
    """The same in the projector."""
    poses: Annotated[int, Field(ge=2)] | None = None
    """How many poses `camera_shared_px` and `projector_shared_px` come from; None where that is unknown."""
    carried: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of the detection error in the camera's image that is carried into the projector's reading."""
    scale: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    """Relative standard uncertainty of the board's scale, which the calibration's covariance contains."""


@dataclass(frozen=True, eq=False)
class FittedBoard:
    """The board of a characterisation."""

    target: dict[str, Any]  # content of the target file
    points: Floats  # points of the board in mm, as the characterisation found them
    errors: FittedErrors  # sizes of the errors


class FittedBoardFile(Document):
    """The board in a calibration file."""

    target: dict[str, Any]
    """Content of the target file."""
    points_mm: tuple[tuple[float, float, float], ...]
    """Points of the board as the characterisation found them, row by row, in mm in the board's frame."""
    errors: FittedErrors
    """Sizes of the errors."""

    @model_validator(mode="after")
    def _is_finite(self) -> FittedBoardFile:
        if not np.isfinite(self.points_mm).all():
            raise ValueError("'points_mm' must be finite")
        return self

    @classmethod
    def of(cls, board: FittedBoard) -> FittedBoardFile:
        rows = tuple((x, y, z) for x, y, z in np.round(board.points, 5).tolist())
        return cls(target=board.target, points_mm=rows, errors=board.errors)

    def board(self) -> FittedBoard:
        return FittedBoard(self.target, np.array(self.points_mm, float).reshape(-1, 3), self.errors)


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
