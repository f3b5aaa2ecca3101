"""Causes that are seen in the points: angle, axis, sampling, a calibration that is no longer the rig's."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.conventions import Floats
from fpplab.diagnosis.catalogue import ScanCause, ScanFinding
from fpplab.patterns.plan import Plan

LEAST_ANGLE_DEG = 5.0
"""Angle between the rays below which noise in depth is more than four times that at 20 degrees."""

LEAST_SENSITIVITY = 0.5
"""Least share of the coordinate's greatest change with depth that a plan's axis should see."""

MOST_EPIPOLAR_PX = 0.3
"""Systematic distance from the epipolar lines beyond which a calibration is not the rig's."""

LEAST_PX_PER_STRIPE = 4.0
"""Camera pixels that a stripe should cover."""

POINTS, NEIGHBOURS = 4000, 64
"""How many points are evaluated, and over how many neighbours epipolar distances are averaged."""


def geometry_findings(cloud: Cloud, plan: Plan, calibration: Calibration) -> Iterator[ScanFinding]:
    """Look for what is wrong with the geometry.

    Parameters
    ----------
    cloud : Cloud
        Points in mm in the camera's frame.
    plan : Plan
        Of the scan.
    calibration : Calibration
        That they were triangulated with.

    Yields
    ------
    ScanFinding
        In no order.
    """
    points = cloud.points[:: max(1, len(cloud) // POINTS)].astype(np.float64)
    angle = float(np.median(triangulation_angles_deg(points, calibration)))
    if angle < LEAST_ANGLE_DEG:
        words = f"the rays of camera and projector meet at {angle:.1f} degrees (at least {LEAST_ANGLE_DEG:g})"
        yield ScanFinding(ScanCause.SMALL_ANGLE, words, LEAST_ANGLE_DEG / max(angle, 0.1))
    by_depth = np.median(np.abs(_by_depth(points, calibration)), axis=0)
    coded = [by_depth["xy".index(axis)] for axis in plan.axes]
    share = float(np.linalg.norm(coded) / np.linalg.norm(by_depth))
    if share < LEAST_SENSITIVITY:
        words = (
            f"fringes along {plan.axes[0]} see {100 * share:.0f} % of the change of the projector's "
            f"coordinate with depth (at least {100 * LEAST_SENSITIVITY:g} %): noise in depth is "
            f"{1 / share:.1f} times as large as it need be"
        )
        yield ScanFinding(ScanCause.WRONG_AXIS, words, LEAST_SENSITIVITY / max(share, 1e-3))
    if (off := systematic_epipolar_px(cloud)) is not None and off > MOST_EPIPOLAR_PX:
        words = (
            f"points lie {off:.2f} projector px off their epipolar lines, systematically (at most "
            f"{MOST_EPIPOLAR_PX:g})"
        )
        yield ScanFinding(ScanCause.STALE_CALIBRATION, words, off / MOST_EPIPOLAR_PX)
    yield from _sampling(points, plan, calibration)


def triangulation_angles_deg(points: Floats, calibration: Calibration) -> Floats:
    """Compute the angle between the rays of camera and projector.

    Parameters
    ----------
    points : Floats
        (N, 3) in mm in the camera's frame.
    calibration : Calibration
        Of the rig.

    Returns
    -------
    Floats
        (N,) in degrees.
    """
    pose = calibration.T_projector_camera
    light = points + pose.rotation.T @ pose.translation
    cosine = np.sum(points * light, axis=1) / np.linalg.norm(points, axis=1) / np.linalg.norm(light, axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def projector_px_per_px(points: Floats, calibration: Calibration) -> Floats:
    """Compute how many projector px one camera px covers at the points, on a surface facing the camera.

    Parameters
    ----------
    points : Floats
        (N, 3) in mm in the camera's frame.
    calibration : Calibration
        Of the rig.

    Returns
    -------
    Floats
        (2,) median along u and along v of the projector.
    """
    mm_per_px = float(np.median(points[:, 2])) / calibration.camera.matrix[0, 0]
    pose = calibration.T_projector_camera
    here = calibration.projector.project(points, pose)
    steps = mm_per_px * np.eye(3)[:2]
    moved = [calibration.projector.project(points + step, pose) - here for step in steps]
    return np.asarray(np.median(np.hypot(*moved), axis=0))


def systematic_epipolar_px(cloud: Cloud) -> float | None:
    """Compute how far points are off their epipolar lines, where noise averages out over neighbours.

    Parameters
    ----------
    cloud : Cloud
        With `epipolar_px` where two axes are coded.

    Returns
    -------
    float or None
        Median over groups of neighbours of the size of their median, in projector px; None where it is not
        known.
    """
    if cloud.epipolar_px is None or len(cloud) < 2 * NEIGHBOURS:
        return None
    usable = len(cloud) // NEIGHBOURS * NEIGHBOURS
    groups = cloud.epipolar_px[:usable].astype(np.float64).reshape(-1, NEIGHBOURS)
    return float(np.median(np.abs(np.median(groups, axis=1))))


def _by_depth(points: Floats, calibration: Calibration) -> Floats:
    """Change (N, 2) of the projector's coordinates in px for 1 mm of depth along the camera's rays."""
    near, far = (points * (1.0 + s / points[:, 2:]) for s in (-0.5, 0.5))
    project, pose = calibration.projector.project, calibration.T_projector_camera
    return np.asarray(project(far, pose) - project(near, pose))


def _sampling(points: Floats, plan: Plan, calibration: Calibration) -> Iterator[ScanFinding]:
    scale = projector_px_per_px(points, calibration)
    for k, axis in enumerate("xy"):
        if axis not in plan.axes:
            continue
        stripes = plan.fringes[plan.finest_set("x" if k == 0 else "y")].stripes
        covered = calibration.projector.size[k] / stripes / float(scale[k])
        if covered < LEAST_PX_PER_STRIPE:
            words = (
                f"the finest stripes along {axis} cover {covered:.1f} camera px (at least "
                f"{LEAST_PX_PER_STRIPE:g})"
            )
            yield ScanFinding(ScanCause.UNDERSAMPLED, words, LEAST_PX_PER_STRIPE / covered)
