"""How a bench looks in its recordings, in addition to its numbers."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

NO_MARGINS = 0.0, 0.0, 0.0, 0.0  # of a board that ends where its target does


@dataclass(frozen=True, eq=False)
class BenchSurroundings:
    """Matt surfaces that stand still in front of camera and projector."""

    mesh: trimesh.Trimesh  # in mm in the camera's frame, front sides towards the camera
    reflectance: NDArray[np.float32]  # of what every pixel of the camera sees where no item hides it


@dataclass(frozen=True, eq=False)
class BoardSheet:
    """The sheet that a board is printed on."""

    margins_mm: tuple[float, float, float, float] = NO_MARGINS
    rim_mm: float = 0.0  # width of a dark frame around the sheet, in mm
    rim_reflectance: float = 0.0  # of the frame, 0 to 1
    texture: NDArray[np.float32] | None = None  # factor by which the reflectance differs from place to place


@dataclass(frozen=True, eq=False)
class Appearance:
    """The sheet of the board, and what stands next to it."""

    sheet: BoardSheet = BoardSheet()  # of the board
    surroundings: BenchSurroundings | None = None  # none where nothing is known
