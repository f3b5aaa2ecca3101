"""Rigid transforms and the pinhole model with Brown-Conrady distortion.

The words and frames are those of `fpplab.conventions`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from fpplab.conventions import Floats, Lattice


@dataclass(frozen=True, eq=False)
class RigidTransform:
    """`T_b_a`: takes coordinates in frame a to frame b, `X_b = rotation X_a + translation`.

    rotation: (3, 3), translation: (3,) in mm.
    """

    rotation: Floats
    translation: Floats

    @classmethod
    def identity(cls) -> RigidTransform:
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_vectors(cls, rotation_rad: Floats, translation: Floats) -> RigidTransform:
        """From OpenCV's rotation vector in rad and a translation in mm."""
        matrix, _ = cv2.Rodrigues(np.asarray(rotation_rad, np.float64).reshape(3))
        return cls(np.asarray(matrix, np.float64), np.asarray(translation, np.float64).reshape(3))

    @property
    def rotation_vector(self) -> Floats:
        """OpenCV's rotation vector in rad, (3,)."""
        # Not OpenCV's own inverse: that takes every angle under 1e-5 rad for none.
        return np.asarray(Rotation.from_matrix(self.rotation).as_rotvec(), np.float64)

    @property
    def matrix(self) -> Floats:
        """Homogeneous (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.translation
        return matrix

    def inverse(self) -> RigidTransform:
        """`T_a_b`."""
        return RigidTransform(self.rotation.T, -self.rotation.T @ self.translation)

    def __matmul__(self, other: RigidTransform) -> RigidTransform:
        """`T_c_b @ T_b_a = T_c_a`."""
        return RigidTransform(
            self.rotation @ other.rotation, self.rotation @ other.translation + self.translation
        )

    def apply(self, points: Floats) -> Floats:
        """Points (..., 3) in frame a, as coordinates in frame b."""
        return np.asarray(points @ self.rotation.T + self.translation)


@dataclass(frozen=True, eq=False)
class Pinhole:
    """A camera or projector: pinhole with OpenCV's distortion.

    size: (width, height) in px. matrix: (3, 3) in px. distortion: (k1, k2, p1, p2, k3).
    lattice: how the pixels lie; it matters to patterns, not to projection.
    """

    size: tuple[int, int]
    matrix: Floats
    distortion: Floats = field(default_factory=lambda: np.zeros(5))
    lattice: Lattice = Lattice.SQUARE

    @classmethod
    def from_focal(
        cls,
        size: tuple[int, int],
        focal_px: tuple[float, float],
        centre_px: tuple[float, float],
        distortion: tuple[float, ...] = (0.0,) * 5,
        lattice: Lattice = Lattice.SQUARE,
    ) -> Pinhole:
        """From focal lengths (fx, fy) and principal point (cx, cy) in px."""
        matrix = np.array([[focal_px[0], 0, centre_px[0]], [0, focal_px[1], centre_px[1]], [0, 0, 1.0]])
        return cls(size, matrix, np.asarray(distortion, np.float64), lattice)

    def project(self, points: Floats, T_device_world: RigidTransform | None = None) -> Floats:
        """Pixels (..., 2) of points (..., 3) in mm; world coordinates when a pose is given.

        OpenCV's model (calib3d, "Detailed Description"), without the derivatives that `cv2.projectPoints`
        always computes from Python: ten times as fast.
        """
        local = np.asarray(points, np.float64)
        if T_device_world is not None:
            local = T_device_world.apply(local)
        x, y = local[..., 0] / local[..., 2], local[..., 1] / local[..., 2]
        k1, k2, p1, p2, k3 = self.distortion
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        xd = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
        yd = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
        (fx, _, cx), (_, fy, cy) = self.matrix[:2]
        return np.stack([fx * xd + cx, fy * yd + cy], axis=-1)

    def normalise(self, pixels: Floats) -> Floats:
        """Undistorted ray slopes (x/z, y/z), (..., 2), of pixels (..., 2); inverse of `project`."""
        flat = np.ascontiguousarray(pixels, np.float64).reshape(-1, 1, 2)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-12)
        slopes = cv2.undistortPointsIter(flat, self.matrix, self.distortion, np.eye(3), np.eye(3), criteria)
        return np.asarray(slopes, np.float64).reshape(np.shape(pixels))
