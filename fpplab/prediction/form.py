"""What the errors of a calibration add to the distance of points from their true surface.

An error of the calibration moves and deforms a whole cloud. The comparison removes the motion, and of what is
left a distance from a surface shows the part along its normal alone. It adds to the noise of each point, so
that a small deformation hardly matters beside a large noise.
"""

from __future__ import annotations

import numpy as np
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison.alignment import AlignmentMesh
from fpplab.core.conventions import Floats, Mask
from fpplab.core.geometry import RigidTransform
from fpplab.reconstruction.uncertainty import CoordinateNoise, displacements_by_mode, rigid_motions

POINTS = 4_000
"""Number of points by which the mean distance is computed, about."""
DRAWS = 500
"""Number of calibrations that are drawn."""


def form_errors(points: Floats, normals: Floats, calibration: Calibration, noise: CoordinateNoise) -> Floats:
    """Compute what the modes of calibration error leave of form along the normals, after an alignment.

    Parameters
    ----------
    points : ndarray of float64
        (N, 3) in mm in the camera's frame.
    normals : ndarray of float64
        Unit normals (N, 3) of the surface there.
    calibration : Calibration
        With a covariance.
    noise : CoordinateNoise
        By which triangulation weights the projector's coordinates.

    Returns
    -------
    ndarray of float64
        (N, n) in mm, by n independent modes of one standard deviation.
    """
    moved = np.einsum("ni,nik->nk", normals, displacements_by_mode(points, calibration, noise))
    rigid = np.einsum("ni,nik->nk", normals, rigid_motions(points - points.mean(axis=0)))
    # Motions within a plane leave no trace: then the smallest is taken.
    return np.asarray(moved - rigid @ np.linalg.lstsq(rigid, moved, rcond=1e-9)[0])


def distance_factors(
    cloud: Cloud, on_shape: Mask, mesh: trimesh.Trimesh, calibration: Calibration, noise: CoordinateNoise
) -> Floats:
    """Draw by which factors errors of a calibration change the mean distance of points from a true surface.

    Parameters
    ----------
    cloud : Cloud
        With pixels, triangulated without an error of the calibration.
    on_shape : ndarray of bool, (height, width)
        Pixels that see the shape.
    mesh : trimesh.Trimesh
        The true shape in mm in the camera's frame.
    calibration : Calibration
        Whose covariance the errors are drawn from.
    noise : CoordinateNoise
        By which triangulation weights the projector's coordinates.

    Returns
    -------
    ndarray of float64
        (DRAWS,), equally likely; 1 alone where the calibration has no covariance.
    """
    if calibration.uncertainty is None:
        return np.ones(1)
    assert cloud.pixels is not None
    u, v = cloud.pixels.T
    points = cloud.points[on_shape[v, u]]
    sample = points[:: max(1, len(points) // POINTS)].astype(np.float64)
    distances, _, normals = AlignmentMesh(mesh).residuals(sample, RigidTransform.identity())
    modes = form_errors(sample, normals, calibration, noise)
    drawn = np.random.default_rng(0).standard_normal((DRAWS, modes.shape[1]))
    return np.asarray(np.abs(distances + drawn @ modes.T).mean(axis=1) / np.abs(distances).mean())
