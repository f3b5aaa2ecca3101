"""Smooth functions of position, computed at a grid of rays and depths and interpolated between them.

What a calibration's error does to a point changes slowly from point to point, and takes long to compute: for
a cloud of millions of points it is computed at some thousand nodes instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from fpplab.core.conventions import Floats

NODES = (25, 19, 13)
"""Along x/z, y/z and z."""
SAMPLE = 20_000
"""About as many evenly sampled points say where the grid lies."""
FEW = 0.001
"""Share of points at each end of each direction that the grid need not hold, such as lie on no surface."""
MARGIN = 0.05
"""By which share of its length the grid reaches beyond the others."""

AnyPoints = NDArray[np.floating[Any]]
CubicWeights = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class RayGrid:
    """A box in x/z, y/z and z, and its nodes.

    Attributes
    ----------
    lower, upper : ndarray of float64, (3,)
        Corners: slopes of the ray, and depth in mm.
    """

    lower: Floats
    upper: Floats

    @classmethod
    def around(cls, points: AnyPoints) -> RayGrid | None:
        """Place a grid around nearly all points.

        Parameters
        ----------
        points : ndarray of floating, (N, 3)
            In mm in the camera's frame.

        Returns
        -------
        RayGrid or None
            None where there are fewer points than nodes.
        """
        if len(points) <= np.prod(NODES):
            return None
        some = points[:: max(1, len(points) // SAMPLE)].astype(np.float64)
        placed = np.stack([some[:, 0] / some[:, 2], some[:, 1] / some[:, 2], some[:, 2]])
        lower, upper = np.quantile(placed, [FEW, 1.0 - FEW], axis=1)
        margin = MARGIN * (upper - lower) + 1e-9 * np.abs(upper)
        return cls(lower - margin, upper + margin)

    @property
    def points(self) -> Floats:
        """The nodes, (N, 3) in mm in the camera's frame."""
        axes = [np.linspace(*ends) for ends in zip(self.lower, self.upper, NODES, strict=True)]
        across, down, depth = (each.ravel() for each in np.meshgrid(*axes, indexing="ij"))
        return np.stack([across * depth, down * depth, depth], axis=-1)

    def interpolate(self, values: Floats, points: AnyPoints) -> NDArray[np.float32]:
        """Interpolate by cubic polynomials along each direction of the grid.

        Parameters
        ----------
        values : ndarray of float64, (nodes, K)
            At `points` of the grid.
        points : ndarray of floating, (N, 3)
            In mm in the camera's frame.

        Returns
        -------
        ndarray of float32, (N, K)
            NaN outside of the grid.
        """
        shaped = np.ascontiguousarray(values.T).reshape(-1, *NODES)
        per_step = (np.array(NODES) - 1) / (self.upper - self.lower)
        found = np.empty((len(points), len(shaped)), np.float32)
        _interpolate(np.ascontiguousarray(points), self.lower, per_step, shaped, found)
        return found


@njit(cache=True)
def _first(place: float, nodes: int) -> int:
    """Give the first of the four nodes around a place."""
    return min(max(int(place) - 1, 0), nodes - 4)


@njit(cache=True)
def _weights(place: float) -> CubicWeights:
    """Give the weights of values at 0, 1, 2 and 3 in the cubic through them, by Lagrange's formula."""
    a, b, c = place - 1.0, place - 2.0, place - 3.0
    return -a * b * c / 6.0, place * b * c / 2.0, -place * a * c / 2.0, place * a * b / 6.0


@njit(parallel=True, cache=True, error_model="numpy", fastmath={"contract"})
def _interpolate(
    points: AnyPoints, lower: Floats, per_step: Floats, values: Floats, found: NDArray[np.float32]
) -> None:
    for i in prange(len(points)):
        _at_point(points[i], lower, per_step, values, found[i])


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _at_point(
    point: AnyPoints, lower: Floats, per_step: Floats, values: Floats, found: NDArray[np.float32]
) -> None:
    inverse = 1.0 / point[2]
    x = (point[0] * inverse - lower[0]) * per_step[0]
    y = (point[1] * inverse - lower[1]) * per_step[1]
    z = (point[2] - lower[2]) * per_step[2]
    count, nodes_x, nodes_y, nodes_z = values.shape
    if not (0.0 <= x <= nodes_x - 1 and 0.0 <= y <= nodes_y - 1 and 0.0 <= z <= nodes_z - 1):
        found[:] = np.nan
        return
    i, j, k = _first(x, nodes_x), _first(y, nodes_y), _first(z, nodes_z)
    along_x, along_y, along_z = _weights(x - i), _weights(y - j), _weights(z - k)
    for n in range(count):
        found[n] = (
            along_x[0] * _in_plane(values, i, j, k, n, along_y, along_z)
            + along_x[1] * _in_plane(values, i + 1, j, k, n, along_y, along_z)
            + along_x[2] * _in_plane(values, i + 2, j, k, n, along_y, along_z)
            + along_x[3] * _in_plane(values, i + 3, j, k, n, along_y, along_z)
        )


@njit(cache=True, fastmath={"contract"})
def _in_plane(
    values: Floats, i: int, j: int, k: int, n: int, along_y: CubicWeights, along_z: CubicWeights
) -> float:
    return (
        along_y[0] * _in_row(values, i, j, k, n, along_z)
        + along_y[1] * _in_row(values, i, j + 1, k, n, along_z)
        + along_y[2] * _in_row(values, i, j + 2, k, n, along_z)
        + along_y[3] * _in_row(values, i, j + 3, k, n, along_z)
    )


@njit(cache=True, fastmath={"contract"})
def _in_row(values: Floats, i: int, j: int, k: int, n: int, along_z: CubicWeights) -> float:
    return float(
        along_z[0] * values[n, i, j, k]
        + along_z[1] * values[n, i, j, k + 1]
        + along_z[2] * values[n, i, j, k + 2]
        + along_z[3] * values[n, i, j, k + 3]
    )
