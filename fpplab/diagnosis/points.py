"""Points of a scan, and what the calibration says of the place where they are."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.config import Positive
from fpplab.core.conventions import Axis, Floats, Map
from fpplab.diagnosis.limits import LimitsSection


@dataclass(frozen=True, eq=False)
class PointSample:
    """Points of a scan."""

    cloud: Cloud  # in mm in the camera's frame
    calibration: Calibration  # that they were triangulated with

    @cached_property
    def points(self) -> Floats:
        """(N, 3) some of the points in mm: at least 4000 where there are as many."""
        return self.cloud.points[:: max(1, len(self.cloud) // 4000)].astype(np.float64)

    @cached_property
    def projector_px_per_px(self) -> Floats:
        """(2,) how many projector px along u and v one camera px covers, on a surface facing the camera."""
        mm_per_px = float(np.median(self.points[:, 2])) / self.calibration.camera.matrix[0, 0]
        here = self._projected(self.points)
        moved = [self._projected(self.points + step) - here for step in mm_per_px * np.eye(3)[:2]]
        return np.asarray(np.median(np.hypot(*moved), axis=0))

    @cached_property
    def px_per_mm_of_depth(self) -> Floats:
        """(2,) change of the projector's u and v in px for 1 mm of depth along the camera's rays."""
        near, far = (self.points * (1.0 + s / self.points[:, 2:]) for s in (-0.5, 0.5))
        return np.asarray(np.median(np.abs(self._projected(far) - self._projected(near)), axis=0))

    def _projected(self, points: Floats) -> Floats:
        return self.calibration.projector.project(points, self.calibration.T_projector_camera)


def triangulation_angles_deg(points: Floats, calibration: Calibration) -> Floats:
    """Compute the angle between the rays of camera and projector."""
    # points (N, 3) mm; returns (N,) degrees
    pose = calibration.T_projector_camera
    light = points + pose.rotation.T @ pose.translation
    cosine = np.sum(points * light, axis=1) / np.linalg.norm(points, axis=1) / np.linalg.norm(light, axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def systematic_epipolar_px(cloud: Cloud, neighbours: int = 64) -> float | None:
    """Compute how far points are off their epipolar lines, where noise averages out over neighbours."""
    if cloud.epipolar_px is None or len(cloud) < 2 * neighbours:
        return None
    usable = len(cloud) // neighbours * neighbours
    groups = cloud.epipolar_px[:usable].astype(np.float64).reshape(-1, neighbours)
    return float(np.median(np.abs(np.median(groups, axis=1))))


class DirectionLimits(LimitsSection):
    """From when on a coordinate runs backwards."""

    min_change: Positive = 0.1
    """Typical change along the image, as a share of that on a surface at constant depth. Derived: a slope
    of the surface changes it, but never its sign; a tenth is left for noise."""


def changes_along_image(coordinate: Map, calibration: Calibration, axis: Axis, stride: int) -> Floats:
    # On a surface at constant depth the calibration predicts how the coordinate changes along the image. A
    # slope of the surface makes it change faster or slower, but never backwards: both devices see its front.
    # coordinate (height, width) px; returns (rows, columns)
    values = coordinate[:-1:stride, :-1:stride].astype(np.float64)
    right = coordinate[:-1:stride, 1::stride][:, : values.shape[1]] - values
    down = coordinate[1::stride, :-1:stride][: values.shape[0]] - values
    expected = expected_change(calibration)["xy".index(axis)]
    return np.asarray((right * expected[0] + down * expected[1]) / (expected @ expected))


def expected_change(calibration: Calibration) -> Floats:
    """Change of the projector's coordinates (u, v) by a pixel to the right and down, (2, 2)."""
    camera, pose = calibration.camera, calibration.T_projector_camera
    pixels = np.array(camera.size) / 2.0 + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    rays = np.concatenate([camera.normalise(pixels), np.ones((3, 1))], axis=1)
    # On a surface three baselines away; the direction hardly depends on the distance.
    projected = calibration.projector.project(3.0 * calibration.baseline_mm * rays, pose)
    return np.stack([projected[1] - projected[0], projected[2] - projected[0]], axis=1)
