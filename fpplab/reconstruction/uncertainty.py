"""Uncertainty of each point of a cloud: the fringes' noise and the calibration's covariance, propagated.

A calibration error moves and rotates the cloud far more than it deforms it. What remains after the best rigid
motion is given separately, because it is what a comparison with a true shape shows. A point's uncertainty is
√trace of its covariance (Helmert's point error), so that independent contributions add in quadrature.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fpplab.calibration.displacements import AnyPoints, CoordinateNoise, ErrorModes
from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core import buffers
from fpplab.core.compiled import kernel
from fpplab.core.conventions import Floats
from fpplab.core.progress import Progress, no_progress
from fpplab.reconstruction.limits import RECONSTRUCTION_LIMITS as LIMITS

NODES = (25, 19, 13)  # along x/z, y/z and z

Singles = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class RayGrid:
    """A box in x/z, y/z and z, and its nodes."""

    lower: Floats  # corners: slopes of the ray, and depth in mm
    upper: Floats  # corners: slopes of the ray, and depth in mm

    @classmethod
    def around(cls, points: AnyPoints) -> RayGrid | None:
        # points (N, 3)
        if len(points) <= np.prod(NODES):
            return None
        some = points[:: max(1, len(points) // LIMITS.grid_sample_points)].astype(np.float64)
        placed = np.stack([some[:, 0] / some[:, 2], some[:, 1] / some[:, 2], some[:, 2]])
        lower, upper = np.quantile(
            placed, [LIMITS.outside_grid_share, 1.0 - LIMITS.outside_grid_share], axis=1
        )
        margin = LIMITS.grid_margin_share * (upper - lower) + 1e-9 * np.abs(upper)
        return cls(lower - margin, upper + margin)

    @property
    def points(self) -> Floats:
        """The nodes, (N, 3) in mm in the camera's frame."""
        axes = [np.linspace(*ends) for ends in zip(self.lower, self.upper, NODES, strict=True)]
        across, down, depth = (each.ravel() for each in np.meshgrid(*axes, indexing="ij"))
        return np.stack([across * depth, down * depth, depth], axis=-1)

    def interpolate(self, values: Floats, points: AnyPoints, out: Singles) -> None:
        """Interpolate by cubic polynomials to `finer_steps` times as many nodes, linearly between those."""
        # values (nodes, 2); points (N, 3); out (2, N)
        finer = values.reshape(*NODES, 2)
        for axis, nodes in enumerate(NODES):
            finer = np.moveaxis(np.tensordot(_cubic_weights(nodes), finer, (1, axis)), 0, axis)
        per_step = LIMITS.finer_steps * (np.array(NODES) - 1) / (self.upper - self.lower)
        _interpolate(
            np.ascontiguousarray(points), self.lower, per_step, np.ascontiguousarray(finer, np.float32), out
        )


def _cubic_weights(nodes: int) -> Floats:
    """Values at `finer_steps` places per step as sums of those at nodes, (finer, nodes), by Lagrange."""
    places = np.arange(LIMITS.finer_steps * (nodes - 1) + 1) / LIMITS.finer_steps
    first = np.clip(places.astype(int) - 1, 0, nodes - 4)
    a = places - first
    b, c, d = a - 1.0, a - 2.0, a - 3.0
    weights = np.zeros((len(places), nodes))
    around = first[:, None] + np.arange(4)
    lagrange = np.stack([-b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0], axis=1)
    np.put_along_axis(weights, around, lagrange, axis=1)
    return weights


@kernel(parallel=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _interpolate(points: AnyPoints, lower: Floats, per_step: Floats, values: Singles, out: Singles) -> None:
    nodes_x, nodes_y, nodes_z = values.shape[:3]
    flat = values.reshape(-1)  # with one index instead of four
    per_x, per_y = np.uintp(2 * nodes_y * nodes_z), np.uintp(2 * nodes_z)
    first, second = out[0], out[1]
    for p in prange(len(points)):
        inverse = 1.0 / points[p, 2]
        x = (points[p, 0] * inverse - lower[0]) * per_step[0]
        y = (points[p, 1] * inverse - lower[1]) * per_step[1]
        z = (points[p, 2] - lower[2]) * per_step[2]
        if not (0.0 <= x <= nodes_x - 1 and 0.0 <= y <= nodes_y - 1 and 0.0 <= z <= nodes_z - 1):
            first[p] = second[p] = np.nan
            continue
        i, j, k = min(int(x), nodes_x - 2), min(int(y), nodes_y - 2), min(int(z), nodes_z - 2)
        at = np.uintp(i) * per_x + np.uintp(j) * per_y + np.uintp(2 * k)
        x, y, z = np.float32(x - i), np.float32(y - j), np.float32(z - k)
        first[p] = _trilinear(flat, at, per_x, per_y, x, y, z)
        second[p] = _trilinear(flat, at + np.uintp(1), per_x, per_y, x, y, z)


@njit(inline="always")
def _trilinear(flat: Singles, at: Any, per_x: Any, per_y: Any, x: Any, y: Any, z: Any) -> Any:
    near, far = _bilinear(flat, at, per_y, y, z), _bilinear(flat, at + per_x, per_y, y, z)
    return near + x * (far - near)


@njit(inline="always")
def _bilinear(flat: Singles, at: Any, per_y: Any, y: Any, z: Any) -> Any:
    per_z = np.uintp(2)
    near = flat[at] + z * (flat[at + per_z] - flat[at])
    far = flat[at + per_y] + z * (flat[at + per_y + per_z] - flat[at + per_y])
    return near + y * (far - near)


@kernel(parallel=True)
def are_positive(values: Singles) -> bool:
    # values (K, N)
    others = 0
    for n in prange(values.shape[1]):
        for k in range(values.shape[0]):
            others += not (values[k, n] > 0)
    return others == 0


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
