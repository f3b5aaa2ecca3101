"""Parameters of the joint adjustment: what is estimated, and how large the errors of each kind are."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import INTRINSICS, POSE
from fpplab.characterisation.limits import USUAL_LIMITS, CharacterisationLimits
from fpplab.characterisation.observation import Observation
from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform

ImageSize = tuple[int, int]  # (width, height) in px

DEFAULT_SCALE_TOLERANCE = 2e-4
"""Relative standard uncertainty of a board's scale where its target file gives none: what a calliper that
reads 0.02 mm verifies over 100 mm."""


class DistortionModel(StrEnum):
    """How many distortion coefficients are estimated in each device; the others are zero."""

    K1 = "k1"
    K2 = "k2"
    TANGENTIAL = "tangential"
    K3 = "k3"
    RATIONAL = "rational"

    @property
    def terms(self) -> tuple[str, ...]:
        """The intrinsic parameters that are free; the first of `INTRINSICS`."""
        return INTRINSICS[: {"k1": 5, "k2": 6, "tangential": 8, "k3": 9, "rational": 12}[self]]


def parameter_names(level: DistortionModel) -> tuple[str, ...]:
    """Name the parameters of both devices that are estimated, in the order of their covariance."""
    terms = [f"{device}.{term}" for device in ("camera", "projector") for term in level.terms]
    return (*terms, *(f"T_projector_camera.{term}" for term in POSE))


@dataclass(frozen=True)
class ErrorSizes:
    """Standard deviations of the errors of each kind."""

    camera_px: float  # of a coordinate of a point detected in the camera's image, in px
    projector_px: float  # of a projector coordinate read there
    in_plane_mm: float  # of a coordinate of a board's point within the board's plane
    out_of_plane_mm: float  # of a board's point from the plane, in mm
    camera_shared_px: float = 0.0
    projector_shared_px: float = 0.0  # the same in the projector
    drift_px: float = 0.0  # by which the projector's picture walks along an axis from pose to pose

    @property
    def independent(self) -> tuple[float, float, float, float]:
        """Those of errors of one point: camera, projector, board within its plane, and out of it."""
        return self.camera_px, self.projector_px, self.in_plane_mm, self.out_of_plane_mm

    @property
    def iterated(self) -> tuple[float, ...]:
        """Those that settle before an estimate of sizes ends."""
        return (*self.independent, self.drift_px or 1.0)


@dataclass(frozen=True, eq=False)
class Solution:
    """All parameters that are adjusted."""

    camera: Floats  # (12,) as named in `INTRINSICS`
    projector: Floats  # (12,) as named in `INTRINSICS`
    T_projector_camera: Floats  # (6,) rotation vector in rad and translation in mm
    poses: Floats  # (M, 6) `T_camera_target` of every pose: rotation vectors in rad and translations in mm
    board: Floats  # (P, 3) points of the board in mm
    carried: float = 0.0  # share of the camera's detection error that is carried into the projector's reading
    # (S, 2) px by which the projector's picture walked from pose to pose, and from the last to what follows
    steps: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    ages: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))  # (M,) steps since each pose

    def shift_px(self, index: int) -> Floats:
        """Sum up by how much the projector's picture lay elsewhere in a pose than the calibration says."""
        # returns (2,) px
        return (
            -self.steps[len(self.steps) - self.ages[index] :].sum(axis=0) if len(self.ages) else np.zeros(2)
        )

    def at_pose(self, pose: Floats, age: NDArray[np.intp] | None = None) -> Solution:
        """Keep one pose only, by default one without drift."""
        # pose (6,); age (1,)
        steps = self.steps[:0] if age is None else self.steps
        return replace(self, poses=pose[None], steps=steps, ages=self.ages[:0] if age is None else age)

    def residuals(self, index: int, observation: Observation) -> tuple[Floats, Floats]:
        # returns camera (K, 2) px, projector (K, 2) px
        points, pose = self.board[observation.ids], self.poses[index]
        camera_errors = project_with_derivatives(points, pose, self.camera)[0] - observation.camera_px
        chained, _ = compose_with_derivatives(pose, self.T_projector_camera)
        lit = project_with_derivatives(points, chained, self.projector)[0] + self.shift_px(index)
        return camera_errors, lit - observation.projector_px


@dataclass(frozen=True)
class BundleSettings:
    """Settings of the iterations of the joint adjustment."""

    huber_limit: float = 3.0
    """Residuals beyond this many robust standard deviations enter linearly, not squared (Huber). Chosen."""
    clipped_mean_square: float = 0.99501
    """Mean square of a normal variable that is cut off at `huber_limit` standard deviations. Derived."""
    min_eigenvalue_ratio: float = 1e-13
    """Least significant eigenvalue of normal equations scaled to a unit diagonal, of the greatest. Chosen."""
    initial_damping: float = 1e-6
    """Damping at which the fit starts, relative to the diagonal of the normal equations. Chosen."""
    max_damping: float = 1e8  # damping at which the fit ends: no step reduces the residuals (chosen)
    max_steps: int = 200  # most steps of the fit (chosen)
    min_relative_gain: float = 1e-7
    """Relative reduction of the loss at which the fit ends. Chosen: a thirtieth of a standard deviation for
    10 000 residuals."""
    max_rounds: int = 20  # most iterations of the estimate of the errors' sizes (chosen)
    max_settled_change: float = 0.01
    """Relative change of the errors' sizes at which their iteration ends. Chosen."""
    initial_board_error_mm: float = 0.03
    """Errors of the board's points in mm from which the estimate starts, without a tolerance. Chosen: printed
    boards are off by tens of µm."""
    min_error_px: float = 1e-6  # least standard deviation in px that is estimated (chosen)
    min_board_error_ratio: float = 0.02
    """Least errors of the board that are estimated, relative to the noise of the camera's points. Chosen:
    smaller ones have no effect."""
    min_independent_share: float = 0.05
    """Least share of the residuals' squares that is ascribed to independent errors. Chosen."""


@dataclass(frozen=True, eq=False)
class Model:
    """What is fitted to observations: the level of the distortion, and the board as it was drawn."""

    level: DistortionModel  # which distortion coefficients are estimated
    drawn: Floats  # (P, 3) points of the board as drawn, in mm
    refined: bool = False  # whether the board's shape is estimated; otherwise it is taken as exact
    tolerance_mm: float | None = None  # from which the estimate of the errors of the board's points starts
    scale_tolerance: float = 0.0  # relative uncertainty of the board's scale, which no image determines
    image_sizes: tuple[ImageSize, ImageSize] | None = None  # (width, height) px
    limits: CharacterisationLimits = USUAL_LIMITS  # by which the fit is judged
    settings: BundleSettings = BundleSettings()  # of its iterations


def vectors_of(transform: RigidTransform) -> Floats:
    """Write a rigid transform as six numbers."""
    # returns (6,) rad
    return np.concatenate([transform.rotation_vector, transform.translation])


def project_with_derivatives(points: Floats, pose: Floats, intrinsics: Floats) -> tuple[Floats, Floats]:
    # points (K, 3) mm; pose (6,) rad; intrinsics (12,); returns pixels (K, 2) px, slopes (2 K, 18)
    fx, fy, cx, cy = intrinsics[:4]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    pixels, slopes = cv2.projectPoints(points, pose[:3], pose[3:], matrix, intrinsics[4:])
    return np.asarray(pixels, np.float64).reshape(-1, 2), np.asarray(slopes, np.float64)


def compose_with_derivatives(pose: Floats, pair: Floats) -> tuple[Floats, tuple[Floats, Floats]]:
    # pose (6,) rad; pair (6,); returns chained (6,), slopes (6, 6)
    out = cv2.composeRT(pose[:3], pose[3:], pair[:3], pair[3:])
    rotation, translation, r_r1, r_t1, r_r2, r_t2, t_r1, t_t1, t_r2, t_t2 = out
    by_pose, by_pair = np.empty((6, 6)), np.empty((6, 6))
    by_pose[:3, :3], by_pose[:3, 3:], by_pose[3:, :3], by_pose[3:, 3:] = r_r1, r_t1, t_r1, t_t1
    by_pair[:3, :3], by_pair[:3, 3:], by_pair[3:, :3], by_pair[3:, 3:] = r_r2, r_t2, t_r2, t_t2
    return np.concatenate([rotation.ravel(), translation.ravel()]), (by_pose, by_pair)
