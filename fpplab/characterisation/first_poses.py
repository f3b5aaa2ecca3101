"""The first poses of a guided characterisation, while nothing is known but what the poses before show.

Three poses, tilted differently and at different distances, determine both devices well enough to choose the
next by their covariance. Until then the camera is taken as a pinhole without distortion whose axis passes the
middle of its image; what the projector lights is known from the first pose by the homography of its plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from fpplab.characterisation.candidate_poses import TILT_DEG, board_grid, tilted_away
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import ImageSize
from fpplab.core.conventions import Floats
from fpplab.core.depth import DepthInterval
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.targets import Target

FIRST_POSES = (
    ((0.0, 0.0), 0.0, (0.0, -1.0)),
    ((-0.6, 0.3), -1.0, (1.0, 0.0)),
    ((0.6, -0.3), 1.0, (-1.0, 1.0)),
)
"""Place from the image's middle, right and down, in half sizes; depth in half ranges; edge that is away."""

FOCAL_GUESS, MIN_FOCAL, MAX_FOCAL = 2.0, 0.5, 20.0
"""Focal length, in sizes of the image, taken where a view does not determine it, and the range believed."""


@dataclass(frozen=True, eq=False)
class RoughView:
    """What the first poses show before the devices can be calibrated."""

    camera: Pinhole  # without distortion
    first: RigidTransform  # T_camera_target of the first pose
    light: Floats  # (3, 3) homography from camera to projector pixels in the first board's plane
    projector_size: ImageSize  # (width, height) in px

    @classmethod
    def of(
        cls, observations: Sequence[Observation], target: Target, sizes: tuple[ImageSize, ImageSize],
        known_pose: RigidTransform | None = None,
    ) -> RoughView:  # fmt: skip
        """Estimate the camera's focal length and the first pose."""
        # sizes (width, height) px
        first, points = observations[0], target.points()[observations[0].ids]
        middle = (0.5 * (sizes[0][0] - 1), 0.5 * (sizes[0][1] - 1))
        centred = [(target.points()[o.ids], o.camera_px - middle) for o in observations]
        focal = (
            _focal_length_from_homographies(centred)
            if known_pose is None
            else _focal_of_known(known_pose.apply(points), centred[0][1])
        )
        focal = focal if MIN_FOCAL * max(sizes[0]) < focal < MAX_FOCAL * max(sizes[0]) else (
            FOCAL_GUESS * max(sizes[0])
        )  # fmt: skip
        camera = Pinhole.from_focal(sizes[0], (focal, focal), middle)
        _, turn, place = cv2.solvePnP(points, first.camera_px, camera.matrix, camera.distortion)
        pose = RigidTransform.from_vectors(np.float64(turn).ravel(), np.float64(place).ravel())
        light, _ = cv2.findHomography(first.camera_px, first.projector_px)
        return cls(camera, pose, np.asarray(light, np.float64), sizes[1])

    def shows(self, places: Floats) -> bool:
        """Tell whether camera and projector both see places, as far as that is known."""
        # places (K, 3) mm
        if not self.camera.sees(places).all():
            return False
        lit = cv2.perspectiveTransform(self.camera.project(places)[None], self.light)[0]
        # A rim is avoided, since the homography holds for the first board's plane alone.
        size = np.array(self.projector_size)
        return bool(((lit > 0.06 * size) & (lit < 0.94 * size)).all())


def first_pose(
    number: int, view: RoughView, target: Target, depth_mm: DepthInterval | None = None
) -> RigidTransform:
    """Choose the second or third pose."""
    (right, down), deep, edge = FIRST_POSES[number % len(FIRST_POSES)]
    sign = 1.0 if number < len(FIRST_POSES) else -1.0
    rotation = tilted_away((sign * edge[0], sign * edge[1]), TILT_DEG)
    near, far = depth_mm or working_depth(view.first)
    z = 0.5 * (near + far) + 0.5 * deep * (far - near)
    half, start = 0.5 * np.array(view.camera.size), view.camera.project(view.first.translation)
    aim = half * (1.0 + np.array([right, down]))
    grid = board_grid(target.size_mm) @ rotation.T
    for share in np.linspace(1.0, 0.0, 9):
        centre = z * np.append(view.camera.normalise(start + share * (aim - start)), 1.0)
        if view.shows(centre + grid):
            break
    return RigidTransform(rotation, centre)


def working_depth(first: RigidTransform, half_range: float = 0.055) -> DepthInterval:
    """Choose the working range of depths where none is stated, as a share of the first board's distance."""
    z = float(first.translation[2])
    return (1.0 - half_range) * z, (1.0 + half_range) * z


def _focal_of_known(places: Floats, centred_px: Floats) -> float:
    slopes = places[:, :2] / places[:, 2:]
    return float(np.sum(slopes * centred_px) / np.sum(slopes**2))


def _focal_length_from_homographies(views: Sequence[tuple[Floats, Floats]]) -> float:
    """Focal length in px by the homographies of tilted boards; NaN where they do not determine it."""
    coefficients, constants = [], []
    for points, pixels in views:
        homography, _ = cv2.findHomography(points[:, :2], pixels)
        if homography is None:
            continue
        scale = np.linalg.norm(homography[2, :2])
        h = homography / scale if scale > 0 else homography
        (a, b), (c, d), (e, f) = h[0, :2], h[1, :2], h[2, :2]
        coefficients += [a * b + c * d, a * a + c * c - b * b - d * d]
        constants += [-e * f, f * f - e * e]
    squares = float(np.dot(coefficients, coefficients))
    inverse = float(np.dot(coefficients, constants)) / squares if squares > 0 else np.nan
    return float(1.0 / np.sqrt(inverse)) if inverse > 0 else np.nan
