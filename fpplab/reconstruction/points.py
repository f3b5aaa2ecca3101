"""Coordinates -> points: triangulate, and remove what lies on no surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded
from fpplab.reconstruction.filtering import filtered
from fpplab.reconstruction.triangulation import triangulate


def points_of(
    decoded: Decoded, calibration: Calibration, plan: Plan, texture: NDArray[np.uint8] | None = None
) -> tuple[Decoded, Cloud]:
    """Triangulate, and filter as the plan says."""
    # texture (height, width)
    cloud = triangulate(decoded, calibration, texture, normals=plan.filter is None)
    return filtered(decoded, cloud, plan, calibration.projector.size)
