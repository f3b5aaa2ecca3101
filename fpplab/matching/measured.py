"""Figures of a recorded measurement of a known shape, as predictions state them."""

from __future__ import annotations

import trimesh

from fpplab.calibration.model import Calibration
from fpplab.comparison.alignment import align_mesh
from fpplab.pipeline import depth_range_of, reconstruct
from fpplab.prediction.figures import MeasuredFigures, figures_of, seen_surface
from fpplab.reconstruction.depth_range import depth_bounds
from fpplab.sessions.session import Session


def measured_figures(session: Session, calibration: Calibration, mesh: trimesh.Trimesh) -> MeasuredFigures:
    """Compute the figures of a scan.

    The shape is aligned with the cloud, for where a part stood is not known as well as it is measured.

    Parameters
    ----------
    session : Session
        A complete scan.
    calibration : Calibration
        Of the rig that took it.
    mesh : trimesh.Trimesh
        The true shape in mm; its pose is where the search begins.

    Returns
    -------
    MeasuredFigures
        Of the points whose pixels see the shape.

    Raises
    ------
    DataError
        The session is damaged, or shows something else.
    CalibrationError
        The calibration is of another rig.
    """
    decoded, cloud = reconstruct(session, calibration)
    T_camera_mesh = align_mesh(cloud.points.astype(float), mesh).transform
    placed = mesh.copy().apply_transform(T_camera_mesh.matrix)
    bounds = depth_bounds(session.plan, calibration, depth_range_of(session))
    seen = seen_surface(placed, calibration)
    return figures_of(decoded, cloud, placed, calibration, session.plan, seen, bounds)
