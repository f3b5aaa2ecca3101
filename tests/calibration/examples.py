"""A calibration whose every number differs from the others."""

import numpy as np

from fpplab.calibration.model import Calibration, Uncertainty
from fpplab.core.conventions import Floats, Lattice
from fpplab.core.geometry import Pinhole, RigidTransform

POLYNOMIAL = np.array([-0.12, 0.2, 1e-3, -8e-4, 0.05])
RATIONAL = np.array([-0.12, 0.2, 1e-3, -8e-4, 0.05, 0.3, -0.02, 0.01])


def calibration(lens: Floats = POLYNOMIAL) -> Calibration:
    """Camera of 1368 x 912 px with the given lens, and projector of 912 x 1140 px."""
    camera = Pinhole((1368, 912), np.array([[3645.1, 0, 683.5], [0, 3640.7, 455.25], [0, 0, 1]]), lens)
    projector = Pinhole(
        (912, 1140),
        np.array([[1094.4, 0, 455.5], [0, 2188.8, 1110.0], [0, 0, 1]]),
        np.array([0.01, -0.02, 0.0, 0.0, 0.0]),
        Lattice.DIAMOND,
    )
    pose = RigidTransform.from_vectors(np.array([0.01, -0.3, 0.02]), np.array([-120.0, 3.0, 12.5]))
    known = Uncertainty(("camera.fx", "T_projector_camera.ry"), np.diag([0.25, 1e-8]))
    return Calibration(camera, projector, pose, {"camera": 0.05, "projector": 0.06, "joint": 0.07}, known)
