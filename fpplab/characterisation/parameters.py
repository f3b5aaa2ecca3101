"""Parameters of the joint adjustment: what is estimated, and how large the errors of each kind are."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np

from fpplab.calibration.model import INTRINSICS, POSE
from fpplab.characterisation.observation import Observation
from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform

ImageSize = tuple[int, int]
"""(width, height) in px."""

DEFAULT_SCALE_TOLERANCE = 2e-4
"""Relative standard uncertainty of a board's scale where its target file gives none: what a calliper that
reads 0.02 mm verifies over 100 mm."""


class DistortionModel(StrEnum):
    """How many distortion coefficients are estimated, in both devices alike; the others are zero."""

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
    """Name the parameters of both devices that are estimated, in the order of their covariance.

    Parameters
    ----------
    level : DistortionModel
        Which distortion coefficients are estimated.

    Returns
    -------
    tuple of str
        Such as `camera.fx`; of `fpplab.calibration.model.PARAMETERS`.
    """
    terms = [f"{device}.{term}" for device in ("camera", "projector") for term in level.terms]
    return (*terms, *(f"T_projector_camera.{term}" for term in POSE))


@dataclass(frozen=True)
class ErrorSizes:
    """Standard deviations of the errors of each kind.

    Attributes
    ----------
    camera_px : float
        Of a coordinate of a point detected in the camera's image, in px.
    projector_px : float
        Of a projector coordinate read there, in px of the projector, beyond what the detection error carries
        into it.
    in_plane_mm : float
        Of a coordinate of a board's point within the board's plane, from where it is drawn, in mm.
    out_of_plane_mm : float
        Of a board's point from the plane, in mm.
    camera_shared_px : float
        Of each smooth function over the board that the errors of one pose share in the camera's image, in px:
        6 functions of mean square 1 in u, and in v.
    projector_shared_px : float
        The same in the projector.
    """

    camera_px: float
    projector_px: float
    in_plane_mm: float
    out_of_plane_mm: float
    camera_shared_px: float = 0.0
    projector_shared_px: float = 0.0


@dataclass(frozen=True, eq=False)
class Solution:
    """All parameters that are adjusted.

    Attributes
    ----------
    camera : Floats
        (12,) as named in `INTRINSICS`.
    projector : Floats
        (12,) as named in `INTRINSICS`.
    T_projector_camera : Floats
        (6,) rotation vector in rad and translation in mm.
    poses : Floats
        (M, 6) `T_camera_target` of every pose: rotation vectors in rad and translations in mm.
    board : Floats
        (P, 3) points of the board in mm.
    carried : float
        Share of the camera's detection error that is carried into the projector's reading, 0 to 1.
    """

    camera: Floats
    projector: Floats
    T_projector_camera: Floats
    poses: Floats
    board: Floats
    carried: float = 0.0

    def residuals(self, index: int, observation: Observation) -> tuple[Floats, Floats]:
        """Compute the reprojection errors of one pose.

        Parameters
        ----------
        index : int
            Of the pose.
        observation : Observation
            What was measured in it.

        Returns
        -------
        camera : Floats
            (K, 2) model minus observation in px.
        projector : Floats
            (K, 2) model minus observation in px.
        """
        points, pose = self.board[observation.ids], self.poses[index]
        seen = view(points, pose, self.camera)[0] - observation.camera_px
        chained, _ = chain(pose, self.T_projector_camera)
        return seen, view(points, chained, self.projector)[0] - observation.projector_px


@dataclass(frozen=True, eq=False)
class Model:
    """What is fitted to observations: the level of the distortion, and the board as it was drawn.

    Attributes
    ----------
    level : DistortionModel
        Which distortion coefficients are estimated.
    drawn : Floats
        (P, 3) points of the board as drawn, in mm.
    refined : bool
        Whether the board's shape is estimated; otherwise it is taken as exact.
    tolerance_mm : float or None
        From which the estimate of the errors of the board's points starts, in mm.
    scale_tolerance : float
        Relative standard uncertainty of the board's scale, which no image tells.
    image_sizes : tuple of ImageSize or None
        (width, height) in px of camera and projector, to whose corners a lens's distortion is known to be
        moderate; None if it is only to the outermost point.
    """

    level: DistortionModel
    drawn: Floats
    refined: bool = False
    tolerance_mm: float | None = None
    scale_tolerance: float = 0.0
    image_sizes: tuple[ImageSize, ImageSize] | None = None


def vectors_of(transform: RigidTransform) -> Floats:
    """Write a rigid transform as six numbers.

    Parameters
    ----------
    transform : RigidTransform
        The transform.

    Returns
    -------
    Floats
        (6,) rotation vector in rad and translation in mm.
    """
    return np.concatenate([transform.rotation_vector, transform.translation])


def view(points: Floats, pose: Floats, intrinsics: Floats) -> tuple[Floats, Floats]:
    """Project points, with derivatives.

    Parameters
    ----------
    points : Floats
        (K, 3) in mm.
    pose : Floats
        (6,) rotation vector in rad and translation in mm into the device's frame.
    intrinsics : Floats
        (12,) as named in `INTRINSICS`.

    Returns
    -------
    pixels : Floats
        (K, 2) in px.
    slopes : Floats
        (2 K, 18) derivatives by rotation, translation, `INTRINSICS`.
    """
    fx, fy, cx, cy = intrinsics[:4]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    pixels, slopes = cv2.projectPoints(points, pose[:3], pose[3:], matrix, intrinsics[4:])
    return np.asarray(pixels, np.float64).reshape(-1, 2), np.asarray(slopes, np.float64)


def chain(pose: Floats, pair: Floats) -> tuple[Floats, tuple[Floats, Floats]]:
    """Compose two rigid transforms, with derivatives.

    Parameters
    ----------
    pose : Floats
        (6,) the first: rotation vector in rad and translation in mm.
    pair : Floats
        (6,) the second.

    Returns
    -------
    chained : Floats
        (6,) `pair @ pose`.
    slopes : tuple[Floats, Floats]
        Its derivatives (6, 6) by `pose` and by `pair`.
    """
    out = cv2.composeRT(pose[:3], pose[3:], pair[:3], pair[3:])
    rotation, translation, r_r1, r_t1, r_r2, r_t2, t_r1, t_t1, t_r2, t_t2 = out
    by_pose, by_pair = np.empty((6, 6)), np.empty((6, 6))
    by_pose[:3, :3], by_pose[:3, 3:], by_pose[3:, :3], by_pose[3:, 3:] = r_r1, r_t1, t_r1, t_t1
    by_pair[:3, :3], by_pair[:3, 3:], by_pair[3:, :3], by_pair[3:, 3:] = r_r2, r_t2, t_r2, t_t2
    return np.concatenate([rotation.ravel(), translation.ravel()]), (by_pose, by_pair)
