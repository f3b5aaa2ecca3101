"""Fitting spheres and planes by geometric least squares, and discarding a permitted share of outliers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from fpplab.core.conventions import Floats, Mask
from fpplab.core.errors import DataError

DISCARDED_SHARE = 0.003
"""Share of the points farthest from the fit, 3 ‰, that a test after VDI/VDE 2634 part 2 may discard."""


@dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere."""

    centre: Floats  # (3,) in mm
    radius: float  # in mm

    def distances(self, points: Floats) -> Floats:
        # points (N, 3) mm; returns (N,) mm
        return np.asarray(np.linalg.norm(points - self.centre, axis=1) - self.radius)


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane."""

    point: Floats  # A point (3,) on the plane in mm; the mean of the points that were fitted
    normal: Floats  # unit normal (3,), towards the origin

    def distances(self, points: Floats) -> Floats:
        # points (N, 3) mm; returns (N,) mm
        return np.asarray((points - self.point) @ self.normal)


def fit_sphere(points: Floats) -> Sphere:
    """Fit a sphere of free radius, least squares in the radial distances."""
    # Gauss-Newton iteration from the algebraic fit, in which `|p|² = 2 p·c + (r² - |c|²)` is linear.
    # points (N, 3) mm
    if len(points) < 4:
        raise DataError(f"a sphere needs at least 4 points, and there are {len(points)}")
    middle = points.mean(axis=0)
    local = points - middle
    scale = float(np.abs(local).max())
    local = local / max(scale, np.finfo(float).tiny)
    rows = np.column_stack([2.0 * local, np.ones(len(local))])
    solution, _, rank, _ = np.linalg.lstsq(rows, (local**2).sum(axis=1), rcond=1e-10)
    if rank < 4:
        raise DataError("the points lie on a plane or a line, which is no sphere; check what was measured")
    centre, radius = solution[:3], float(np.sqrt(max(solution[3] + solution[:3] @ solution[:3], 0.0)))
    smallest = 1e-12  # relative step at which the fit has converged, chosen near rounding
    for _ in range(50):
        away = local - centre
        length = np.linalg.norm(away, axis=1)
        jacobian = np.column_stack([away / np.maximum(length, smallest)[:, None], np.ones(len(local))])
        step = np.linalg.lstsq(jacobian, length - radius, rcond=None)[0]
        centre, radius = centre + step[:3], radius + float(step[3])
        if np.linalg.norm(step) <= smallest * (1.0 + abs(radius)):
            break
    if not (np.isfinite(radius) and radius > 0.0):
        raise DataError("the fit of a sphere does not converge; check what was measured")
    return Sphere(middle + scale * centre, scale * radius)


def fit_plane(points: Floats) -> Plane:
    """Fit a plane, least squares in the distances along its normal."""
    # points (N, 3) mm
    if len(points) < 3:
        raise DataError(f"a plane needs at least 3 points, and there are {len(points)}")
    middle = points.mean(axis=0)
    spread, axes = np.linalg.eigh((points - middle).T @ (points - middle))
    if spread[1] <= 1e-12 * spread[2]:
        raise DataError("the points lie on a line, which is no plane; check what was measured")
    normal = axes[:, 0]
    return Plane(middle, np.asarray(-normal if normal @ middle > 0.0 else normal))


F = TypeVar("F", Sphere, Plane)


def fit_without_worst(
    points: Floats, fit: Callable[[Floats], F], share: float = DISCARDED_SHARE
) -> tuple[F, Mask]:
    """Fit a shape to all points but those farthest from it."""
    # Exactly `floor(share * N)` points are discarded: those farthest from the fit. They are chosen again
    # after each fit, from all points, until the choice no longer changes (50 times at most).
    # points (N, 3) mm; fit (M, 3); returns kept (N,)
    keep = np.ones(len(points), bool)
    feature = fit(points)
    discarded = int(np.floor(share * len(points)))
    if discarded == 0:
        return feature, keep
    for _ in range(50):
        order = np.argsort(np.abs(feature.distances(points)), kind="stable")
        chosen = np.zeros(len(points), bool)
        chosen[order[: len(points) - discarded]] = True
        if (chosen == keep).all():
            break
        keep = chosen
        feature = fit(points[keep])
    return feature, keep


def peak_to_peak(values: Floats) -> float:
    return float(values.max() - values.min())
