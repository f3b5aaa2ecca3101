"""How errors of the devices move what they measure: place, and form once rigid motion is removed."""

from __future__ import annotations

import numpy as np

from fpplab.calibration.model import INTRINSICS
from fpplab.characterisation.parameters import DistortionModel, Solution, project_with_derivatives
from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform


def moved_points(solution: Solution, level: DistortionModel, places: Floats) -> Floats:
    """Differentiate triangulated points by the devices' parameters, all pixels held."""
    # places (m, 3) mm; returns (3 m, n) mm
    free, still = len(level.terms), np.zeros(6)
    imaged = project_with_derivatives(places, still, solution.camera)[1].reshape(-1, 2, 6 + len(INTRINSICS))
    lit = project_with_derivatives(places, solution.T_projector_camera, solution.projector)[1].reshape(
        imaged.shape
    )
    turn = RigidTransform.from_vectors(solution.T_projector_camera[:3], np.zeros(3)).rotation
    by_place = np.concatenate([imaged[..., 3:6], lit[..., 3:6] @ turn], axis=1)
    by_device = np.zeros((len(places), 4, 2 * free + 6))
    by_device[:, :2, :free] = imaged[..., 6 : 6 + free]
    by_device[:, 2:, free : 2 * free] = lit[..., 6 : 6 + free]
    by_device[:, 2:, 2 * free :] = lit[..., :6]
    return np.asarray(-np.linalg.pinv(by_place) @ by_device).reshape(-1, 2 * free + 6)


def without_motion(moved: Floats, places: Floats) -> Floats:
    """Take the best rigid motion from changes of places: what remains is a change of form."""
    # moved (3 m, n) mm; places (m, 3) mm; returns (3 m, n) mm
    x, y, z = (places - places.mean(axis=0)).T
    zero, unit = np.zeros_like(x), np.ones_like(x)
    turns = [(zero, -z, y), (z, zero, -x), (-y, x, zero)]
    shifts = [(unit, zero, zero), (zero, unit, zero), (zero, zero, unit)]
    motions = np.stack([np.stack(m, axis=1).ravel() for m in (*turns, *shifts)], axis=1)
    basis, _ = np.linalg.qr(motions)
    return np.asarray(moved - basis @ (basis.T @ moved))
