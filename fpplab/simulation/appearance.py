"""How a bench looks beside what numbers tell, as its recordings show it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

NO_MARGINS = 0.0, 0.0, 0.0, 0.0
"""Of a board that ends where its target does."""


@dataclass(frozen=True, eq=False)
class BenchSurroundings:
    """Matt surfaces that stand still in front of camera and projector.

    Attributes
    ----------
    mesh : trimesh.Trimesh
        In mm in the camera's frame, front sides towards the camera.
    reflectance : ndarray of float32
        Of what every pixel of the camera sees where no item hides it, (height, width), 0 to 1.
    """

    mesh: trimesh.Trimesh
    reflectance: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class BoardSheet:
    """The sheet that a board is printed on.

    Attributes
    ----------
    margins_mm : tuple of float
        Width of the blank sheet beyond the target on the left, top, right and bottom, as the target is
        printed, in mm.
    rim_mm : float
        Width of a dark frame around the sheet, in mm.
    rim_reflectance : float
        Of the frame, 0 to 1.
    texture : ndarray of float32 or None
        Factor by which the reflectance differs from place to place, [v, u] over the sheet with its margins;
        None where it is 1.
    """

    margins_mm: tuple[float, float, float, float] = NO_MARGINS
    rim_mm: float = 0.0
    rim_reflectance: float = 0.0
    texture: NDArray[np.float32] | None = None


@dataclass(frozen=True, eq=False)
class Appearance:
    """The sheet of the board, and what stands beside it.

    Attributes
    ----------
    sheet : BoardSheet
        Of the board.
    surroundings : BenchSurroundings or None
        None where nothing is known.
    """

    sheet: BoardSheet = BoardSheet()
    surroundings: BenchSurroundings | None = None
