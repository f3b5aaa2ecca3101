"""Figures of a measurement of a known shape, computed in the same way for predictions and sessions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import igl
import numpy as np
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.conventions import Floats, Mask
from fpplab.core.errors import DataError
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded
from fpplab.phase.bounds import DecodingBounds, widest_interval_share
from fpplab.phase.order_risk import order_risk
from fpplab.reconstruction.triangulation import camera_rays

EDGE_PX = 0.5
"""By how much a projected point must lie within the projector's image to count as lit, in px (chosen)."""


@dataclass(frozen=True)
class MeasuredFigures:
    """Figures of one measurement."""

    distance_um: float  # mean distance of the points from the true surface, in µm
    noise_um: float  # median standard uncertainty of a point by the noise of the images, in µm
    completeness: float  # share of the pixels that see lit surface which became points
    wrong_order: float  # mean probability that the fringe order of a point is wrong, by noise alone

    def summary(self) -> dict[str, float]:
        """Give plain values."""
        return asdict(self)


def median_figures(measured: Sequence[MeasuredFigures]) -> MeasuredFigures:
    """Give the median of every figure."""
    every = np.array([list(figures.summary().values()) for figures in measured])
    return MeasuredFigures(*np.median(every, axis=0).tolist())


def seen_surface(mesh: trimesh.Trimesh, calibration: Calibration) -> tuple[Mask, Mask]:
    """Find the pixels that see a shape, and those where it is lit as well."""
    # returns (height, width)
    shape, rays = RayTracedShape(mesh), camera_rays(calibration.camera)
    directions = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    depth = shape.depth(np.zeros(3), directions.reshape(-1, 3)).reshape(rays.shape[:2])
    seen: Mask = np.isfinite(depth)
    hits = directions[seen] * depth[seen][:, None]
    lit = np.zeros_like(seen)
    lit[seen] = _is_lit(shape, hits, calibration)
    return seen, lit


def _is_lit(shape: RayTracedShape, points: Floats, calibration: Calibration) -> Mask:
    u, v = calibration.projector.project(points, calibration.T_projector_camera).T
    width, height = calibration.projector.size
    within = (u > EDGE_PX) & (u < width - 1 - EDGE_PX) & (v > EDGE_PX) & (v < height - 1 - EDGE_PX)
    return np.asarray(within & shape.unoccluded(calibration.projector_centre, points))


def figures_of(
    decoded: Decoded,
    cloud: Cloud,
    mesh: trimesh.Trimesh,
    calibration: Calibration,
    plan: Plan,
    surface: tuple[Mask, Mask],
    bounds: DecodingBounds | None = None,
) -> MeasuredFigures:
    """Compute the figures of a measurement."""
    # decoded (height, width); surface: what `seen_surface` gives, (height, width)
    assert cloud.pixels is not None
    u, v = cloud.pixels.T
    on_shape, lit = surface
    counted = on_shape[v, u]
    if not counted.any():
        raise DataError("no point lies on the true shape: check the item's pose, light and exposure")
    points = cloud.points[counted].astype(np.float64)
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    square = igl.point_mesh_squared_distance(points, vertices, faces)[0]
    size = calibration.projector.size
    interval_shares = (
        {axis: widest_interval_share(bounds, axis, size) for axis in plan.axes} if bounds else None
    )
    risk = order_risk(decoded, plan, size, interval_shares)[v[counted], u[counted]]
    assert cloud.sigma_noise_mm is not None
    return MeasuredFigures(
        distance_um=1e3 * float(np.sqrt(square).mean()),
        noise_um=1e3 * float(np.median(cloud.sigma_noise_mm[counted])),
        completeness=float(np.count_nonzero(lit[v, u]) / max(1, np.count_nonzero(lit))),
        wrong_order=float(np.nanmean(risk)),
    )
