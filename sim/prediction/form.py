"""What the errors of a calibration add to the distance of points from their true surface.

An error of the calibration moves and deforms a whole cloud. The comparison removes the motion, and of what is
left a distance from a surface shows the part along its normal alone. It adds to the noise of each point, so
that a small deformation hardly matters next to a large noise.
"""

from dataclasses import dataclass

import numpy as np

from fpplab.calibration.displacements import CoordinateNoise, displacements_by_mode
from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison.alignment import AlignmentMesh
from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform
from fpplab.reconstruction.uncertainty import rigid_motions
from sim.prediction.figures import SeenShape

DRAWS = 500  # of calibrations (chosen: ends of an interval of 95 % vary by a few per cent)


@dataclass(frozen=True, eq=False)
class CalibrationEffects:
    """What calibrations do to a measurement that are as likely as the one at hand, drawn K times."""

    distance: Floats  # factors of the distance from the true shape, after an alignment, (K,)
    place_um: Floats  # RMS motion that the alignment removes, (K,)


def form_error_by_mode(
    points: Floats, normals: Floats, calibration: Calibration, noise: CoordinateNoise
) -> tuple[Floats, Floats]:
    """Split what the modes of calibration error do: form along the normals, and what an alignment removes."""
    # points (N, 3) mm; normals (N, 3); returns (N, n), (N, 3, n), both in mm
    motions = rigid_motions(points - points.mean(axis=0))
    moved = np.einsum("ni,nik->nk", normals, displacements_by_mode(points, calibration, noise))
    rigid = np.einsum("ni,nik->nk", normals, motions)
    # Motions within a plane leave no trace: then the smallest is taken.
    motion = np.linalg.lstsq(rigid, moved, rcond=1e-9)[0]
    return np.asarray(moved - rigid @ motion), motions @ motion


def calibration_effects(
    cloud: Cloud,
    shape: SeenShape,
    calibration: Calibration,
    noise: CoordinateNoise,
    aligned: RigidTransform | None = None,
) -> CalibrationEffects:
    """Draw what calibration errors do to distance and place; `aligned` moved the shape to the points."""
    points = cloud.points[shape.on_it(cloud)]
    sample = points[:: max(1, len(points) // 4_000)].astype(np.float64)  # some 4,000 give the mean
    away = np.zeros_like(sample) if aligned is None else sample - aligned.inverse().apply(sample)
    if calibration.uncertainty is None:
        return CalibrationEffects(np.ones(1), 1e3 * _rms_lengths(away[..., None]))
    distances, _, normals = AlignmentMesh(shape.mesh).residuals(sample, RigidTransform.identity())
    form, motion = form_error_by_mode(sample, normals, calibration, noise)
    drawn = np.random.default_rng(0).standard_normal((DRAWS, form.shape[1]))
    factors = np.abs(distances + drawn @ form.T).mean(axis=1) / np.abs(distances).mean()
    few = slice(None, None, 10)  # of a rigid motion
    moved = away[few, :, None] + motion[few] @ drawn.T
    return CalibrationEffects(np.asarray(factors), 1e3 * _rms_lengths(moved))


def _rms_lengths(moved: Floats) -> Floats:
    """Root mean square length (K,) of displacements (N, 3, K)."""
    return np.asarray(np.sqrt(np.square(moved).sum(axis=1).mean(axis=0)))
