"""Spheres and planes by geometric least squares, and the share of points that a test may leave out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from fpplab.core.conventions import Floats, Mask
from fpplab.core.errors import DataError

DISCARDED_SHARE = 0.003
"""Of the points, the farthest from the fit: VDI/VDE 2634 part 2 allows 3 per mille."""
ROUNDS = 50
STILL = 1e-12
"""Relative step at which the fit of a sphere ends."""


class FittedFeature(Protocol):
    """A fitted shape."""

    def distances(self, points: Floats) -> Floats:
        """Signed distances (N,) in mm of points (N, 3) from the shape."""
        ...


@dataclass(frozen=True, eq=False)
class Sphere:
    """centre: (3,) in mm. radius: in mm."""

    centre: Floats
    radius: float

    def distances(self, points: Floats) -> Floats:
        """Radial, positive outside."""
        return np.asarray(np.linalg.norm(points - self.centre, axis=1) - self.radius)


@dataclass(frozen=True, eq=False)
class Plane:
    """point: (3,) in mm, the mean of what was fitted. normal: (3,), unit, towards the origin."""

    point: Floats
    normal: Floats

    def distances(self, points: Floats) -> Floats:
        """Along the normal, positive towards the origin, where the camera is."""
        return np.asarray((points - self.point) @ self.normal)


def fit_sphere(points: Floats) -> Sphere:
    """The sphere of free radius that is least squares in the radial distances of points (N, 3).

    Gauss and Newton's method from the algebraic fit, in which `|p|² = 2 p·c + (r² - |c|²)` is linear.
    Raises `DataError` when the points are fewer than four or lie on no sphere of their own.
    """
    if len(points) < 4:
        raise DataError(f"a sphere needs at least 4 points, and there are {len(points)}")
    middle = points.mean(axis=0)
    local = points - middle
    scale = float(np.abs(local).max())
    local = local / max(scale, np.finfo(float).tiny)
    rows = np.column_stack([2.0 * local, np.ones(len(local))])
    solution, _, rank, _ = np.linalg.lstsq(rows, (local**2).sum(axis=1), rcond=1e-10)
    if rank < 4:
        raise DataError("the points lie on a plane or a line, which is no sphere; see what was measured")
    centre, radius = solution[:3], float(np.sqrt(max(solution[3] + solution[:3] @ solution[:3], 0.0)))
    for _ in range(ROUNDS):
        away = local - centre
        length = np.linalg.norm(away, axis=1)
        jacobian = np.column_stack([away / np.maximum(length, STILL)[:, None], np.ones(len(local))])
        step = np.linalg.lstsq(jacobian, length - radius, rcond=None)[0]
        centre, radius = centre + step[:3], radius + float(step[3])
        if np.linalg.norm(step) <= STILL * (1.0 + abs(radius)):
            break
    if not (np.isfinite(radius) and radius > 0.0):
        raise DataError("the fit of a sphere does not converge; see what was measured")
    return Sphere(middle + scale * centre, scale * radius)


def fit_plane(points: Floats) -> Plane:
    """The plane that is least squares in the distances along its normal of points (N, 3).

    Raises `DataError` when the points are fewer than three or lie on a line.
    """
    if len(points) < 3:
        raise DataError(f"a plane needs at least 3 points, and there are {len(points)}")
    middle = points.mean(axis=0)
    spread, axes = np.linalg.eigh((points - middle).T @ (points - middle))
    if spread[1] <= 1e-12 * spread[2]:
        raise DataError("the points lie on a line, which is no plane; see what was measured")
    normal = axes[:, 0]
    return Plane(middle, np.asarray(-normal if normal @ middle > 0.0 else normal))


F = TypeVar("F", bound=FittedFeature)


def fit_without_worst(
    points: Floats, fit: Callable[[Floats], F], share: float = DISCARDED_SHARE
) -> tuple[F, Mask]:
    """The fit to all but the worst points, and which (N,) were kept.

    Exactly `floor(share * N)` points are discarded: those farthest from the fit. Which they are is
    decided again after each fit, from all points, until it stays the same.
    """
    keep = np.ones(len(points), bool)
    feature = fit(points)
    discarded = int(np.floor(share * len(points)))
    if discarded == 0:
        return feature, keep
    for _ in range(ROUNDS):
        order = np.argsort(np.abs(feature.distances(points)), kind="stable")
        chosen = np.zeros(len(points), bool)
        chosen[order[: len(points) - discarded]] = True
        if (chosen == keep).all():
            break
        keep = chosen
        feature = fit(points[keep])
    return feature, keep


def peak_to_peak(values: Floats) -> float:
    """Greatest minus least."""
    return float(values.max() - values.min())
