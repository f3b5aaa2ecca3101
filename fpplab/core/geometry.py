"""Rigid transforms, and the pinhole model with OpenCV's rational distortion (Claus and Fitzgibbon, 2005)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from fpplab.core.conventions import Floats, Lattice, Mask

DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # the coefficients of a lens, in OpenCV's order
POLYNOMIAL = 5  # number of coefficients of the polynomial model; those after them are the rational model's
PIXEL_TOLERANCE = 1e-10  # error in px at which the iterative inversion of the distortion ends (chosen)
INVERSION_STEPS = 50  # most iterations of that inversion (chosen)


@dataclass(frozen=True, eq=False)
class RigidTransform:
    """`T_b_a`: takes coordinates in frame a to frame b, `X_b = rotation X_a + translation`."""

    rotation: Floats  # (3, 3)
    translation: Floats  # (3,) in mm

    @classmethod
    def identity(cls) -> RigidTransform:
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_vectors(cls, rotation_rad: Floats, translation: Floats) -> RigidTransform:
        # rotation_rad (3,) rad; translation (3,) mm
        matrix, _ = cv2.Rodrigues(np.asarray(rotation_rad, np.float64).reshape(3))
        return cls(np.asarray(matrix, np.float64), np.asarray(translation, np.float64).reshape(3))

    @cached_property
    def rotation_vector(self) -> Floats:
        """OpenCV's rotation vector in rad, (3,), read-only."""
        # Not OpenCV's own inverse, which returns zero for every angle below 1e-5 rad.
        difference = self.rotation - self.rotation.T
        turn = np.array([difference[2, 1], difference[0, 2], difference[1, 0]]) / 2.0
        sine, cosine = float(np.linalg.norm(turn)), float(np.trace(self.rotation) - 1.0) / 2.0
        vector = turn * (math.atan2(sine, cosine) / sine if sine > 0.0 else 1.0)
        if cosine < 0.0:  # towards half a turn the sine vanishes, and with it the axis
            from scipy.spatial.transform import Rotation  # a tenth of a second that most poses do not need

            vector = np.array(Rotation.from_matrix(self.rotation).as_rotvec(), np.float64)
        vector.flags.writeable = False
        return vector

    @property
    def matrix(self) -> Floats:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.translation
        return matrix

    def inverse(self) -> RigidTransform:
        return RigidTransform(self.rotation.T, -self.rotation.T @ self.translation)

    def moved(self, by: Floats) -> RigidTransform:
        """Translate frame a, with the rotation held."""
        # by (3,) mm
        return RigidTransform(self.rotation, self.translation + by)

    def __matmul__(self, other: RigidTransform) -> RigidTransform:
        """Compose transforms: `T_c_b @ T_b_a = T_c_a`."""
        return RigidTransform(
            self.rotation @ other.rotation, self.rotation @ other.translation + self.translation
        )

    def apply(self, points: Floats) -> Floats:
        # points (..., 3) mm; returns (..., 3) mm
        return np.asarray(points @ self.rotation.T + self.translation)


def turned_towards(T_b_a: RigidTransform, angle_rad: float) -> RigidTransform:
    """Rotate frame b about its own origin, its z axis towards a's origin."""
    # The axis of rotation is normal to z and to the line between the two origins: for a projector and a
    # camera this is their convergence.
    axis = np.cross((0.0, 0.0, 1.0), T_b_a.translation)
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        raise ValueError("the other origin lies on the z axis: no direction to turn in")
    turn = RigidTransform.from_vectors(angle_rad * axis / length, np.zeros(3))
    return turn.inverse() @ T_b_a


# Other modules compile it into their kernels, whose caches numba renews only when those modules change.
def distort(x: Any, y: Any, lens: Floats | Sequence[float]) -> tuple[Any, Any, Any, Any, Any]:
    k1, k2, p1, p2, k3, k4, k5, k6 = lens
    square = x * x + y * y
    below = 1.0 / (1.0 + square * (k4 + square * (k5 + square * k6)))
    radial = (1.0 + square * (k1 + square * (k2 + square * k3))) * below
    growth = 2.0 * below * (
        (k1 + square * (2.0 * k2 + square * 3.0 * k3))
        - radial * (k4 + square * (2.0 * k5 + square * 3.0 * k6))
    )  # fmt: skip
    xd = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
    yd = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
    xx = radial + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    xy = growth * x * y + 2.0 * p1 * x + 2.0 * p2 * y
    yy = radial + growth * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    return xd, yd, xx, xy, yy


@dataclass(frozen=True, eq=False)
class Pinhole:
    """A camera or projector: pinhole with OpenCV's distortion."""

    size: tuple[int, int]  # (width, height) in px
    matrix: Floats  # (3, 3) in px
    distortion: Floats = field(default_factory=lambda: np.zeros(len(DISTORTION)))  # (8,)
    lattice: Lattice = Lattice.SQUARE  # arrangement of the pixels; it matters to patterns, not to projection

    def __post_init__(self) -> None:
        coefficients = np.asarray(self.distortion, np.float64)
        object.__setattr__(self, "distortion", np.pad(coefficients, (0, len(DISTORTION) - len(coefficients))))

    @classmethod
    def from_focal(
        cls,
        size: tuple[int, int],
        focal_px: tuple[float, float],
        centre_px: tuple[float, float],
        distortion: tuple[float, ...] = (),
        lattice: Lattice = Lattice.SQUARE,
    ) -> Pinhole:
        # size (width, height) px; focal_px (fx, fy) px; centre_px (cx, cy) px
        matrix = np.array([[focal_px[0], 0, centre_px[0]], [0, focal_px[1], centre_px[1]], [0, 0, 1.0]])
        return cls(size, matrix, np.asarray(distortion, np.float64), lattice)

    @property
    def coefficients(self) -> Floats:
        """The distortion as written to files: (5,) where the rational terms are zero, otherwise (8,)."""
        return self.distortion if self.distortion[POLYNOMIAL:].any() else self.distortion[:POLYNOMIAL]

    @property
    def intrinsics(self) -> Floats:
        """The numbers fx, fy, cx, cy and the eight coefficients of the distortion, (12,)."""
        return np.append(self.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], self.distortion)

    @cached_property
    def reach(self) -> float:
        """Slope √(x² + y²) up to which the radial distortion is invertible."""
        # There it folds back, or has a pole; infinite where neither happens.
        k1, k2, _, _, k3, k4, k5, k6 = self.distortion
        above, below = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])
        square = np.poly1d([1.0, 0.0])
        grown = (above + 2 * square * above.deriv()) * below - 2 * square * above * below.deriv()
        # As polynomials of 1/r², whose first coefficient is 1 however small the others are.
        ends = np.concatenate([np.roots(each.coeffs[::-1]) for each in (grown, below)])
        ends = ends[(np.abs(ends.imag) <= 1e-12 * np.abs(ends)) & (ends.real > 0)].real
        return float(1.0 / np.sqrt(ends.max())) if ends.size else np.inf

    def cropped(self, corner: tuple[int, int], size: tuple[int, int]) -> Pinhole:
        # size (width, height) px
        matrix = self.matrix.copy()
        matrix[:2, 2] -= corner
        return Pinhole(size, matrix, self.distortion, self.lattice)

    def project(self, points: Floats, T_device_world: RigidTransform | None = None) -> Floats:
        # Without the derivatives by pose and intrinsics that `cv2.projectPoints` always computes from Python:
        # several times as fast. Beyond `reach` the model has pixels too, but a lens has not.
        # points (..., 3) mm; returns (..., 2) px
        local = np.asarray(points, np.float64)
        if T_device_world is not None:
            local = T_device_world.apply(local)
        xd, yd, *_ = distort(local[..., 0] / local[..., 2], local[..., 1] / local[..., 2], self.distortion)
        (fx, _, cx), (_, fy, cy) = self.matrix[:2]
        return np.stack([fx * xd + cx, fy * yd + cy], axis=-1)

    def sees(
        self, points: Floats, T_device_world: RigidTransform | None = None, margin_px: float = 0.0
    ) -> Mask:
        """Tell which points fall into the image; occlusion is not considered."""
        # points (..., 3) mm
        local = np.asarray(points, np.float64)
        if T_device_world is not None:
            local = T_device_world.apply(local)
        visible = np.asarray(local[..., 2] > 0.0)
        # Far outside the image the distortion may fold back into it, so the rays are bounded first.
        visible[visible] = np.hypot(local[visible, 0], local[visible, 1]) < self.reach * local[visible, 2]
        pixels, edge = self.project(local[visible]), margin_px - 0.5
        visible[visible] = ((pixels >= edge) & (pixels <= np.array(self.size) - 1 - edge)).all(axis=-1)
        return visible

    def normalise(self, pixels: Floats) -> Floats:
        """Undistort pixels to ray slopes; inverse of `project`. By Newton's method to `PIXEL_TOLERANCE`."""
        # pixels (..., 2) px; returns (..., 2)
        (fx, _, cx), (_, fy, cy) = self.matrix[:2]
        coordinates = np.asarray(pixels, np.float64)
        aim_x, aim_y = (coordinates[..., 0] - cx) / fx, (coordinates[..., 1] - cy) / fy
        x, y = aim_x, aim_y
        last = np.zeros_like(x)
        with np.errstate(all="ignore"):
            for _ in range(INVERSION_STEPS):
                # A step beyond the reach, or a start there, is shortened to half way.
                length = np.hypot(x, y)
                last = np.where(length < self.reach, length, 0.5 * (last + self.reach))
                scale = np.where(length > 0, last / length, 1.0)
                x, y = scale * x, scale * y
                xd, yd, xx, xy, yy = distort(x, y, self.distortion)
                off_x, off_y, determinant = aim_x - xd, aim_y - yd, xx * yy - xy * xy
                met = (np.abs(fx * off_x) < PIXEL_TOLERANCE) & (np.abs(fy * off_y) < PIXEL_TOLERANCE)
                met &= determinant > 0
                if met.all():
                    break
                x = np.where(met, x, x + (yy * off_x - xy * off_y) / determinant)
                y = np.where(met, y, y + (xx * off_y - xy * off_x) / determinant)
        return np.where(met[..., None], np.stack([x, y], axis=-1), np.nan)
