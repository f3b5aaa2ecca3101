"""Pose of the grey card for which the response was measured, from the bench's scan of it."""

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Floats
from fpplab.core.errors import DataError
from fpplab.core.geometry import RigidTransform
from fpplab.core.robust import huber_weights, robust_spread
from fpplab.pipeline.measuring import reconstruct_points
from fpplab.sessions.session import Session

MAX_BENT_MM = 0.5
"""Robust standard deviation of points from a plane beyond which they are of no flat card (chosen)."""


def card_pose(session: Session, calibration: Calibration, nominal: RigidTransform) -> RigidTransform:
    # Of six numbers a plane determines three; the card is turned and moved from its nominal pose only as far
    # as these ask for.
    _, cloud = reconstruct_points(session, calibration)
    points = cloud.points.astype(np.float64)
    if len(points) < 100:
        raise DataError(f"{session.path}: the card's pose needs at least 100 points, found {len(points)}")
    centre, normal, spread = fitted_plane(points)
    if spread > MAX_BENT_MM:
        raise DataError(
            f"{session.path}: the points are {spread:.2f} mm off a plane (at most {MAX_BENT_MM:g}): this is "
            "no scan of a flat card"
        )
    return moved_into_plane(nominal, centre, normal)


def fitted_plane(points: Floats) -> tuple[Floats, Floats, float]:
    """Fit a plane, robust against points of other objects."""
    # points (P, 3) mm; returns centre (3,) mm, normal (3,)
    weight = np.ones(len(points))
    for _ in range(10):  # of new weights (chosen)
        centre = weight @ points / weight.sum()
        off = points - centre
        normal = np.linalg.eigh((off * weight[:, None]).T @ off)[1][:, 0]
        distance = off @ normal
        spread = robust_spread(distance)
        weight = huber_weights(distance, spread)
    return centre, normal * np.sign(normal[2] or 1.0), spread


def moved_into_plane(pose: RigidTransform, centre: Floats, normal: Floats) -> RigidTransform:
    """Turn and move a pose so that its x and y axes lie in a plane, as little as possible."""
    # centre, normal (3,) mm
    axis = pose.rotation[:, 2]
    facing = normal * np.sign(axis @ normal or 1.0)
    across = np.cross(axis, facing)
    angle = np.arctan2(np.linalg.norm(across), axis @ facing)
    turn = across / max(float(np.linalg.norm(across)), 1e-12) * angle
    rotation = RigidTransform.from_vectors(turn, np.zeros(3)).rotation @ pose.rotation
    return RigidTransform(rotation, pose.translation + ((centre - pose.translation) @ normal) * normal)
