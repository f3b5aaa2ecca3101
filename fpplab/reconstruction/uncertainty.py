"""Uncertainty of each point of a cloud: the fringes' noise and the calibration's covariance, propagated.

A calibration error moves and rotates the cloud far more than it deforms it. What remains after the best rigid
motion is given separately, because it is what a comparison with a true shape shows. A point's uncertainty is
√trace of its covariance (Helmert's point error), so that independent contributions add in quadrature.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from fpplab.calibration.displacements import AnyPoints, CoordinateNoise, ErrorModes
from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core import buffers
from fpplab.core.conventions import Floats
from fpplab.core.progress import Progress, no_progress
from fpplab.reconstruction.limits import RECONSTRUCTION_LIMITS as LIMITS
from fpplab.reconstruction.ray_grid import RayGrid, are_positive


def with_uncertainty(
    cloud: Cloud, calibration: Calibration, noise: CoordinateNoise, progress: Progress = no_progress
) -> Cloud:
    if calibration.uncertainty is None:
        return cloud
    modes = ErrorModes.of(calibration, noise)
    sample = cloud.points[:: max(1, len(cloud) // LIMITS.rigid_sample_points)].astype(np.float64)
    centre = sample.mean(axis=0)
    motion = _rigid_part(modes, sample, centre)

    def exactly(points: AnyPoints, progress: Progress = no_progress) -> Floats:
        variances = np.empty((2, len(points)))
        for part in _blocks(len(points)):
            moved = modes.moved(points[part])
            deformed = moved - rigid_motions(points[part] - centre) @ motion
            variances[0, part], variances[1, part] = _squares(moved), _squares(deformed)
            progress(part.stop / len(points))
        return variances

    variances = _by_grid(cloud.points, exactly, progress)
    whole, form = np.sqrt(variances, out=variances).astype(np.float32, copy=False)
    return replace(cloud, sigma_calibration_mm=whole, sigma_form_mm=form)


def _by_grid(
    points: AnyPoints, exactly: Callable[[AnyPoints, Progress], Floats], progress: Progress
) -> AnyPoints:
    variances = buffers.empty((2, len(points)))
    grid = RayGrid.around(points)
    if grid is None:
        return exactly(points, progress)
    grid.interpolate(exactly(grid.points, lambda share: progress(0.9 * share)).T, points, variances)
    # Outside, or so near to 0 that interpolation passes it.
    if not are_positive(variances):
        outside = np.flatnonzero(~((variances[0] > 0) & (variances[1] > 0)))
        variances[:, outside] = exactly(points[outside], no_progress)
    progress(1.0)
    return variances


def point_covariance(cloud: Cloud, calibration: Calibration, noise: CoordinateNoise) -> Floats:
    # How points vary together follows from `calibration_jacobian`.
    # returns (N, 3, 3) mm²
    modes, covariance = ErrorModes.of(calibration, noise), np.empty((len(cloud), 3, 3))
    for part in _blocks(len(cloud)):
        moved = modes.moved(cloud.points[part])
        covariance[part] = moved @ moved.transpose(0, 2, 1)
    if (sigma := cloud.sigma_along_ray_mm) is not None:
        points = cloud.points.astype(np.float64)
        along = points * (sigma / np.linalg.norm(points, axis=1))[:, None]
        covariance += along[:, :, None] * along[:, None, :]
    return covariance


def _rigid_part(modes: ErrorModes, sample: Floats, centre: Floats) -> Floats:
    """Fit a rigid motion of a sample of the cloud, (6, n) for `rigid_motions`, to each mode."""
    normal, right = np.zeros((6, 6)), np.zeros((6, modes.changes.shape[1]))
    for part in _blocks(len(sample)):
        motions = rigid_motions(sample[part] - centre).reshape(-1, 6)
        normal += motions.T @ motions
        right += motions.T @ modes.moved(sample[part]).reshape(len(motions), -1)
    # Points on one line leave a rotation undetermined; then the smallest is taken.
    return np.asarray(np.linalg.lstsq(normal, right, rcond=None)[0])


def rigid_motions(points: AnyPoints) -> Floats:
    # points (N, 3) mm; returns (N, 3, 6) mm
    x, y, z = points.T
    motions = np.zeros((len(points), 3, 6))
    motions[:, range(3), range(3)] = 1.0
    motions[:, 1, 3], motions[:, 2, 3] = -z, y
    motions[:, 0, 4], motions[:, 2, 4] = z, -x
    motions[:, 0, 5], motions[:, 1, 5] = -y, x
    return motions


def _squares(moved: Floats) -> Floats:
    """Return the trace of `moved movedᵀ` at each point, (N,)."""
    return np.asarray(np.einsum("nij,nij->n", moved, moved))


def _blocks(count: int) -> Iterator[slice]:
    for start in range(0, count, LIMITS.block_points):
        yield slice(start, min(start + LIMITS.block_points, count))
