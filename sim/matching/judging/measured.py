"""Figures of a measurement of a known shape, of a bench's session or of frames, as predictions state them.

The shape is aligned with the points, for where a part stood is not known as well as it is measured.
"""

from dataclasses import replace

import numpy as np
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison.alignment import align_mesh
from fpplab.core.depth import DepthRange
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.pipeline.measuring import reconstruct_points
from fpplab.reconstruction.depth_range import decoding_bounds
from fpplab.reconstruction.points import points_of
from fpplab.reconstruction.triangulation import coordinate_noise
from fpplab.sessions.session import Session
from sim.prediction.figures import MeasuredFigures, SeenShape, figures_of
from sim.prediction.form import calibration_effects


def measured_figures(session: Session, calibration: Calibration, mesh: trimesh.Trimesh) -> MeasuredFigures:
    points = reconstruct_points(session, calibration)
    return _figures(points, calibration, mesh, session.plan, session.depth)[0]


def recorded_figures(
    recording: Recording, calibration: Calibration, mesh: trimesh.Trimesh, depth: DepthRange | None = None
) -> MeasuredFigures:
    """Compute the figures of frames that are in no session, as those of a twin."""
    points = _points(recording, calibration, depth)
    return _figures(points, calibration, mesh, recording.plan, depth)[0]


def expected_figures(
    recording: Recording, calibration: Calibration, mesh: trimesh.Trimesh, depth: DepthRange | None = None
) -> MeasuredFigures:
    """Compute the figures of frames as a bench would see them, whose calibration is in error."""
    points = decoded, cloud = _points(recording, calibration, depth)
    figures, shape = _figures(points, calibration, mesh, recording.plan, depth)
    factors = calibration_effects(cloud, shape, calibration, coordinate_noise(decoded)).distance
    return replace(figures, distance_um=figures.distance_um * float(np.median(factors)))


def _points(
    recording: Recording, calibration: Calibration, depth: DepthRange | None
) -> tuple[Decoded, Cloud]:
    bounds = decoding_bounds(recording.plan, calibration, depth)
    return points_of(decode(recording, bounds=bounds), calibration, recording.plan)


def _figures(
    points: tuple[Decoded, Cloud],
    calibration: Calibration,
    mesh: trimesh.Trimesh,
    plan: Plan,
    depth: DepthRange | None,
) -> tuple[MeasuredFigures, SeenShape]:
    """The figures, and the shape where its points are."""
    T_camera_mesh = align_mesh(points[1].points.astype(float), mesh).transform
    shape = SeenShape.of(mesh.copy().apply_transform(T_camera_mesh.matrix), calibration)
    bounds = decoding_bounds(plan, calibration, depth)
    return figures_of(*points, shape, plan, bounds, calibration.projector.size), shape
