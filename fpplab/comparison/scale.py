"""The scale of a cloud: what a rigid alignment cannot show, found by fitting a similarity after it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpplab.comparison.alignment import AlignmentMesh
from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform
from fpplab.core.robust import cell_numbers, clustered_covariance, huber_weights, robust_spread


@dataclass(frozen=True)
class ScaleLimits:
    """Limits of the fit of a scale."""

    points: int = 40_000  # points that the scale is fitted to, drawn at random (chosen)
    rounds: int = 20  # iterations of the fit (chosen)
    converged_scale: float = 1e-9  # change of the scale (chosen: a thousandth of a ppm)
    cells_across: int = 12
    """Cells of space across the mesh's diagonal, within which errors correlate (chosen)"""
    min_cells: int = 15  # with points, for seven parameters (chosen: about two for each)
    edge_spreads: float = 6.0  # standard deviations from an edge within which points are left out (chosen)
    min_same_face_cosine: float = 0.95  # between normals of faces that form no edge: 18 degrees (chosen)
    min_own_share: float = 1e-6  # of the scale's effect that no rigid motion has too (chosen above rounding)
    coverage: float = 3.0  # standard uncertainties of a deviation that is real (chosen: 0.3 % by chance)


LIMITS = ScaleLimits()


@dataclass(frozen=True)
class FittedScale:
    """The scale of a best-fit similarity, cloud divided by true shape."""

    ppm: float  # scale minus one, in 1e-6: positive when the cloud is too large
    sigma_ppm: float  # its standard uncertainty in 1e-6
    spread_mm: float  # root mean square distance of the points from their centre in mm

    @property
    def effect_um(self) -> float:
        """Root mean square distance, in µm, by which this scale moves the points away from their centre."""
        return abs(self.ppm) * 1e-3 * self.spread_mm

    @property
    def significant(self) -> bool:
        """Whether the scale differs from one by more than `LIMITS.coverage` standard uncertainties."""
        return abs(self.ppm) > LIMITS.coverage * self.sigma_ppm

    def summary(self) -> dict[str, object]:
        return {"ppm": self.ppm, "sigma_ppm": self.sigma_ppm, "effect_um": self.effect_um}


def fit_scale(points: Floats, target: AlignmentMesh, seed: int = 0) -> FittedScale | None:
    # points (N, 3) mm
    if len(points) > LIMITS.points:
        points = points[np.random.default_rng(seed).choice(len(points), LIMITS.points, replace=False)]
    points = points[_clear_of_edges(points, target)]
    if len(points) < LIMITS.min_cells:
        return None
    centre = points.mean(axis=0)
    pose, scale = RigidTransform.identity(), 1.0
    for _ in range(LIMITS.rounds):
        smaller = centre + (points - centre) / scale
        distance, placed, normals = target.residuals(smaller, pose)
        weight = huber_weights(distance, robust_spread(distance))
        rows = _distance_derivatives(placed - centre, normals, target.size)
        matrix = rows.T @ (rows * weight[:, None])
        if not _determines_scale(matrix):
            return None
        # Motions that the shape does not determine, such as a turn about its axis, stay zero.
        step = np.linalg.lstsq(matrix, rows.T @ (weight * distance), rcond=1e-12)[0]
        scale *= 1.0 + float(step[6]) / target.size
        turn = RigidTransform.from_vectors(-step[:3] / target.size, np.zeros(3))
        pose = RigidTransform(turn.rotation, centre - step[3:6] - turn.rotation @ centre) @ pose
        if np.abs(step).max() < LIMITS.converged_scale * target.size:
            break
    cell = cell_numbers(placed, target.size / LIMITS.cells_across)
    if cell.max() + 1 < LIMITS.min_cells:
        return None
    covariance = clustered_covariance(rows, weight * distance, weight == 1.0, cell)
    sigma = float(np.sqrt(covariance[6, 6]))
    spread_mm = float(np.sqrt(np.mean(np.sum((points - centre) ** 2, axis=1))))
    return FittedScale(1e6 * (scale - 1.0), 1e6 * sigma / target.size, spread_mm)


def _clear_of_edges(points: Floats, target: AlignmentMesh) -> NDArray[np.bool_]:
    """Find the points (N,) whose face would be the same if noise had moved them in or out."""
    # Next to an edge the nearest face depends on the noise, always in favour of the smaller distance; at the
    # convex edges of a part that makes it look larger.
    distance, placed, normals = target.residuals(points, RigidTransform.identity())
    reach, kept = LIMITS.edge_spreads * robust_spread(distance), np.ones(len(points), np.bool_)
    for side in (-reach, reach):
        moved = target.residuals(placed + side * normals, RigidTransform.identity())[2]
        kept &= np.einsum("ij,ij->i", moved, normals) > LIMITS.min_same_face_cosine
    return kept


def _distance_derivatives(local: Floats, normals: Floats, size: float) -> Floats:
    """Differentiate the distances (N,) by rotation and scale, both times the size, and by translation."""
    along = np.einsum("ij,ij->i", local, normals)[:, None]
    return np.hstack([np.cross(local, normals) / size, normals, along / size])


def _determines_scale(matrix: Floats) -> bool:
    """Tell whether the scale's column is not a combination of those of the rigid motion."""
    rigid = np.linalg.lstsq(matrix[:6, :6], matrix[:6, 6], rcond=1e-12)[0]
    return bool(matrix[6, 6] - matrix[:6, 6] @ rigid > LIMITS.min_own_share * matrix[6, 6])
