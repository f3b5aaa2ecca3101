"""What the errors of a calibration add to the distance of points from their true surface.

An error of the calibration moves and deforms a whole cloud. The comparison removes the motion, and of what is
left a distance from a surface shows the part along its normal alone. It adds to the noise of each point, so
that a small deformation hardly matters next to a large noise.
"""

from __future__ import annotations

import numpy as np
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison.alignment import AlignmentMesh
from fpplab.core.conventions import Floats, Mask
from fpplab.core.geometry import RigidTransform
from fpplab.reconstruction.triangulation import CoordinateNoise
from fpplab.reconstruction.uncertainty import displacements_by_mode, rigid_motions


def form_error_by_mode(
    points: Floats, normals: Floats, calibration: Calibration, noise: CoordinateNoise
) -> Floats:
    """Compute what the modes of calibration error leave of form along the normals, after an alignment."""
    # points (N, 3) mm; normals (N, 3); returns (N, n) mm
    moved = np.einsum("ni,nik->nk", normals, displacements_by_mode(points, calibration, noise))
    rigid = np.einsum("ni,nik->nk", normals, rigid_motions(points - points.mean(axis=0)))
    # Motions within a plane leave no trace: then the smallest is taken.
    return np.asarray(moved - rigid @ np.linalg.lstsq(rigid, moved, rcond=1e-9)[0])


def distance_factors(
    cloud: Cloud, on_shape: Mask, mesh: trimesh.Trimesh, calibration: Calibration, noise: CoordinateNoise
) -> Floats:
    """Draw factors by which calibration errors change the mean distance from a true surface."""
    # on_shape (height, width); returns (500,)
    if calibration.uncertainty is None:
        return np.ones(1)
    assert cloud.pixels is not None
    u, v = cloud.pixels.T
    points = cloud.points[on_shape[v, u]]
    sample = points[:: max(1, len(points) // 4_000)].astype(np.float64)  # some 4,000 give the mean
    distances, _, normals = AlignmentMesh(mesh).residuals(sample, RigidTransform.identity())
    modes = form_error_by_mode(sample, normals, calibration, noise)
    drawn = np.random.default_rng(0).standard_normal((500, modes.shape[1]))
    return np.asarray(np.abs(distances + drawn @ modes.T).mean(axis=1) / np.abs(distances).mean())
