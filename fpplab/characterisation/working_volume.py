"""The working volume, and how well a calibration knows the form of what is measured in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fpplab.calibration.model import INTRINSICS, Calibration
from fpplab.characterisation.parameters import DistortionModel, Solution, project_with_derivatives
from fpplab.core.conventions import Floats
from fpplab.core.depth import DepthInterval
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import RigidTransform

COLUMNS, ROWS, DEPTHS = 9, 7, 3  # sample of the working volume: pixels across the camera's image, and depths


@dataclass(frozen=True, eq=False)
class WorkingVolume:
    """Places that camera and projector both see, within a range of depths."""

    points: Floats  # (m, 3) evenly spread over it, in mm in the camera's frame

    @classmethod
    def of(cls, calibration: Calibration, depth_mm: DepthInterval) -> WorkingVolume:
        """Sample what both devices see."""
        camera = calibration.camera
        u, v = (np.linspace(0, n - 1, k) for n, k in zip(camera.size, (COLUMNS, ROWS), strict=True))
        slopes = camera.normalise(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
        slopes = slopes[np.isfinite(slopes).all(axis=1)]
        rays = np.column_stack([slopes, np.ones(len(slopes))])
        points = (np.linspace(*depth_mm, DEPTHS)[:, None, None] * rays).reshape(-1, 3)
        visible = points[calibration.projector.sees(points, calibration.T_projector_camera)]
        if len(visible) < 2 * DEPTHS:
            raise CalibrationError(
                f"camera and projector see next to nothing in common from {depth_mm[0]:.0f} to "
                f"{depth_mm[1]:.0f} mm from the camera; turn both to one place, or correct the range"
            )
        return cls(visible)

    def slopes(self, solution: Solution, level: DistortionModel) -> tuple[Floats, Floats]:
        """Differentiate what is measured here by the devices' parameters."""
        # returns place (3 m, n), form (3 m, n)
        moved = moved_points(solution, level, self.points) / np.sqrt(len(self.points))
        return moved, without_motion(moved, self.points)

    def form_mm(self, solution: Solution, level: DistortionModel, covariance: Floats) -> float:
        # covariance (n, n)
        _, slopes = self.slopes(solution, level)
        return float(np.sqrt(max(np.einsum("mi,ij,mj->", slopes, covariance, slopes), 0.0)))

    @cached_property
    def radius_mm(self) -> float:
        """Root mean square distance of the points from their centre in mm: how far a scale moves them."""
        centred = self.points - self.points.mean(axis=0)
        return float(np.sqrt(np.mean(np.sum(centred**2, axis=1))))


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
