"""What a simulation shows beside its items, as a bench's recordings show it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Matt surfaces that stand still in front of camera and projector.

    Attributes
    ----------
    mesh : trimesh.Trimesh
        In mm in the camera's frame, front sides towards the camera.
    reflectance : ndarray of float32
        Of what every pixel of the camera sees where no item hides it, (height, width), 0 to 1.
    rim_mm : float
        Width of a black frame that moves with the board, in mm.
    """

    mesh: trimesh.Trimesh
    reflectance: NDArray[np.float32]
    rim_mm: float = 0.0
