"""Smooth functions of position, computed at a grid of rays and depths and interpolated between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fpplab.calibration.displacements import AnyPoints
from fpplab.core.compiled import kernel
from fpplab.core.conventions import Floats
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
