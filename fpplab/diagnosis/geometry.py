"""Causes that are seen in the points: angle, axis, sampling, a calibration that is no longer the rig's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.conventions import Floats, Lattice, axis_length
from fpplab.diagnosis.catalogue import FaultCause, Finding
from fpplab.patterns.plan import Plan

LEAST_ANGLE_DEG = 5.0
"""Angle between the rays below which noise in depth is more than four times that at 20 degrees."""

LEAST_SENSITIVITY = 0.5
"""Least share of the coordinate's greatest change with depth that a plan's axis should see."""

MOST_EPIPOLAR_PX = 0.3
"""Systematic distance from the epipolar lines beyond which a calibration is not the rig's."""

LEAST_PX_PER_STRIPE = 4.0
"""Camera pixels that a stripe should cover."""

ASPECTS = {Lattice.SQUARE: 1.0, Lattice.DIAMOND: 2.0}
"""Distance of columns beside that of rows, by lattice."""

MOST_STRETCHED = 0.05
"""Greatest share by which a projector's picture may be stretched."""

STRETCHED_HARM = 1.5
"""Excess at most of a stretched picture: points are right if the calibration was made with it."""

POINTS, NEIGHBOURS = 4000, 64
"""How many points are evaluated, and over how many neighbours epipolar distances are averaged."""


@dataclass(frozen=True, eq=False)
class PointSample:
    """Points of a scan."""

    cloud: Cloud  # in mm in the camera's frame
    calibration: Calibration  # that they were triangulated with

    @cached_property
    def points(self) -> Floats:
        """(N, 3) some of the points in mm."""
        return self.cloud.points[:: max(1, len(self.cloud) // POINTS)].astype(np.float64)

    @cached_property
    def projector_px_per_px(self) -> Floats:
        """(2,) how many projector px along u and v one camera px covers, on a surface facing the camera."""
        mm_per_px = float(np.median(self.points[:, 2])) / self.calibration.camera.matrix[0, 0]
        here = self._seen(self.points)
        moved = [self._seen(self.points + step) - here for step in mm_per_px * np.eye(3)[:2]]
        return np.asarray(np.median(np.hypot(*moved), axis=0))

    @cached_property
    def px_per_mm_of_depth(self) -> Floats:
        """(2,) change of the projector's u and v in px for 1 mm of depth along the camera's rays."""
        near, far = (self.points * (1.0 + s / self.points[:, 2:]) for s in (-0.5, 0.5))
        return np.asarray(np.median(np.abs(self._seen(far) - self._seen(near)), axis=0))

    def _seen(self, points: Floats) -> Floats:
        return self.calibration.projector.project(points, self.calibration.T_projector_camera)


def geometry_findings(sample: PointSample, plan: Plan) -> Iterator[Finding]:
    """Look for what is wrong with the geometry."""
    angle = float(np.median(triangulation_angles_deg(sample.points, sample.calibration)))
    if angle < LEAST_ANGLE_DEG:
        words = f"the rays of camera and projector meet at {angle:.1f} degrees (at least {LEAST_ANGLE_DEG:g})"
        yield Finding(FaultCause.SMALL_ANGLE, words, LEAST_ANGLE_DEG / max(angle, 0.1))
    by_depth = sample.px_per_mm_of_depth
    coded = [by_depth["xy".index(axis)] for axis in plan.axes]
    share = float(np.linalg.norm(coded) / np.linalg.norm(by_depth))
    if share < LEAST_SENSITIVITY:
        words = (
            f"fringes along {plan.axes[0]} see {100 * share:.0f} % of the change of the projector's "
            f"coordinate with depth (at least {100 * LEAST_SENSITIVITY:g} %): noise in depth is "
            f"{1 / share:.1f} times as large as it need be"
        )
        yield Finding(FaultCause.WRONG_AXIS, words, LEAST_SENSITIVITY / max(share, 1e-3))
    if (off := systematic_epipolar_px(sample.cloud)) is not None and off > MOST_EPIPOLAR_PX:
        words = (
            f"points lie {off:.2f} projector px off their epipolar lines, systematically (at most "
            f"{MOST_EPIPOLAR_PX:g})"
        )
        yield Finding(FaultCause.STALE_CALIBRATION, words, off / MOST_EPIPOLAR_PX)
    if (stretched := _aspect(sample.calibration)) is not None:
        yield stretched
    yield from _sampling(sample, plan)


def _aspect(calibration: Calibration) -> Finding | None:
    """A projector whose focal lengths do not belong to the lattice of mirrors that is stated."""
    matrix, lattice = calibration.projector.matrix, calibration.projector.lattice
    aspect, wanted = float(matrix[1, 1] / matrix[0, 0]), ASPECTS[lattice]
    off = abs(aspect / wanted - 1.0)
    if off <= MOST_STRETCHED:
        return None
    words = (
        f"by the calibration a column of the projector's picture is {aspect:.2f} times as wide as a row is "
        f"high, but {wanted:g} times with the lattice '{lattice.value}' (at most {100 * MOST_STRETCHED:g} % "
        "off)"
    )
    return Finding(FaultCause.WRONG_RESOLUTION, words, min(off / MOST_STRETCHED, STRETCHED_HARM))


def triangulation_angles_deg(points: Floats, calibration: Calibration) -> Floats:
    """Compute the angle between the rays of camera and projector."""
    # points (N, 3) mm; returns (N,) degrees
    pose = calibration.T_projector_camera
    light = points + pose.rotation.T @ pose.translation
    cosine = np.sum(points * light, axis=1) / np.linalg.norm(points, axis=1) / np.linalg.norm(light, axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def systematic_epipolar_px(cloud: Cloud) -> float | None:
    """Compute how far points are off their epipolar lines, where noise averages out over neighbours."""
    if cloud.epipolar_px is None or len(cloud) < 2 * NEIGHBOURS:
        return None
    usable = len(cloud) // NEIGHBOURS * NEIGHBOURS
    groups = cloud.epipolar_px[:usable].astype(np.float64).reshape(-1, NEIGHBOURS)
    return float(np.median(np.abs(np.median(groups, axis=1))))


def _sampling(sample: PointSample, plan: Plan) -> Iterator[Finding]:
    for axis in plan.axes:
        stripes = plan.fringes[plan.finest_set(axis)].stripes
        covered = axis_length(sample.calibration.projector.size, axis) / stripes
        covered /= float(sample.projector_px_per_px["xy".index(axis)])
        if covered < LEAST_PX_PER_STRIPE:
            words = (
                f"the finest stripes along {axis} cover {covered:.1f} camera px (at least "
                f"{LEAST_PX_PER_STRIPE:g})"
            )
            yield Finding(FaultCause.UNDERSAMPLED, words, LEAST_PX_PER_STRIPE / covered)
