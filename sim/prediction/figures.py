"""Figures of a measurement of a known shape, computed in the same way for predictions and sessions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import igl
import numpy as np
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison.compare import distances_from_cloud, visible_samples
from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.conventions import Floats, Mask
from fpplab.core.errors import DataError
from fpplab.devices.simulation import Rows
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded
from fpplab.phase.bounds import DecodingBounds, widest_interval_share
from fpplab.phase.order_risk import order_risk
from fpplab.reconstruction.triangulation import camera_rays

EDGE_PX = 0.5
"""By how much a projected point must lie within the projector's image to count as lit, in px (chosen)."""
MAX_SAMPLES = 400_000  # of the whole true surface, of which a side has some 100,000 (chosen)


@dataclass(frozen=True)
class MeasuredFigures:
    """Figures of one measurement."""

    distance_um: float  # surface SMCD after the alignment, as `compare --align` gives it, in µm
    noise_um: float  # median standard uncertainty of a point by the noise of the images, in µm
    completeness: float  # share of the pixels that see lit surface which became points
    wrong_order: float  # mean probability that the fringe order of a point is wrong, by noise alone

    def summary(self) -> dict[str, float]:
        return asdict(self)


def median_figures(measured: Sequence[MeasuredFigures]) -> MeasuredFigures:
    """Give the median of every figure."""
    every = np.array([list(figures.summary().values()) for figures in measured])
    return MeasuredFigures(*np.median(every, axis=0).tolist())


@dataclass(frozen=True, eq=False)
class SeenShape:
    """The true shape where it stands, and what the devices see of it."""

    mesh: trimesh.Trimesh  # in the camera's frame, in mm
    seen: Mask  # pixels that see it, (height, width)
    lit: Mask  # those where it is lit as well, (height, width)
    samples: Floats  # places of it that both devices see, as `compare` chooses them, (M, 3) mm
    rows: Mask  # of the image, whether they count, (height,)
    unsampled_mm: float = 0.0
    """By how much the mean distance of all samples from exact points exceeds that of those in `rows`."""

    @classmethod
    def of(cls, mesh: trimesh.Trimesh, calibration: Calibration, rows: Rows | None = None) -> SeenShape:
        """Look at a shape; of a sample of the image only `rows` (R,) count."""
        shape = RayTracedShape(mesh)
        seen, lit, points = _seen_and_lit(shape, calibration)
        counted = np.isin(np.arange(len(seen)), rows) if rows is not None else np.ones(len(seen), bool)
        if not (lit & counted[:, None]).any():
            raise DataError("no pixel sees lit surface of the true shape")
        density = MAX_SAMPLES / float(mesh.area)
        samples = visible_samples(mesh, shape, calibration, density, seed=0).samples
        at = np.rint(calibration.camera.project(samples)[:, 1]).astype(np.intp)
        chosen = counted[np.clip(at, 0, len(counted) - 1)]
        if chosen.all():
            return cls(mesh, seen, lit, samples, counted)
        # Edges and shadows, where truth is far from any point, lie in few rows; how far, geometry tells.
        pixels = np.stack(np.nonzero(lit)[::-1], axis=1).astype(np.int32)
        exact = Cloud(points.astype(np.float32), pixels, calibration.camera.size)
        off = distances_from_cloud(samples, exact, np.ones(len(points), bool))
        unsampled = float(off.mean() - off[chosen].mean())
        return cls(mesh, seen, lit, samples[chosen], counted, unsampled)

    @property
    def counted(self) -> Mask:
        """Pixels that see the shape in rows that count, (height, width)."""
        return self.seen & self.rows[:, None]

    def on_it(self, cloud: Cloud) -> Mask:
        """Find the points (N,) that count."""
        assert cloud.pixels is not None
        u, v = cloud.pixels.T
        return np.asarray(self.counted[v, u])


def seen_surface(mesh: trimesh.Trimesh, calibration: Calibration) -> tuple[Mask, Mask]:
    """Find the pixels that see a shape, and those where it is lit as well."""
    return _seen_and_lit(RayTracedShape(mesh), calibration)[:2]


def _seen_and_lit(shape: RayTracedShape, calibration: Calibration) -> tuple[Mask, Mask, Floats]:
    """Find the pixels that see a shape, those where it is lit, and the points that these see."""
    # returns (height, width), (height, width), (N, 3) mm
    rays = camera_rays(calibration.camera)
    directions = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    depth = shape.depth(np.zeros(3), directions.reshape(-1, 3)).reshape(rays.shape[:2])
    visible: Mask = np.isfinite(depth)
    hits = directions[visible] * depth[visible][:, None]
    lit = np.zeros_like(visible)
    lit[visible] = _is_lit(shape, hits, calibration)
    return visible, lit, hits[lit[visible]]


def _is_lit(shape: RayTracedShape, points: Floats, calibration: Calibration) -> Mask:
    u, v = calibration.projector.project(points, calibration.T_projector_camera).T
    width, height = calibration.projector.size
    within = (u > EDGE_PX) & (u < width - 1 - EDGE_PX) & (v > EDGE_PX) & (v < height - 1 - EDGE_PX)
    return np.asarray(within & shape.unoccluded(calibration.projector_centre, points))


def figures_of(
    decoded: Decoded,
    cloud: Cloud,
    shape: SeenShape,
    plan: Plan,
    bounds: DecodingBounds | None,
    size: tuple[int, int],
) -> MeasuredFigures:
    """Compute the figures of a measurement of a shape that is aligned with it; `size` is the projector's."""
    # decoded (height, width)
    assert cloud.pixels is not None
    assert cloud.sigma_noise_mm is not None
    u, v = cloud.pixels.T
    counted, lit = shape.on_it(cloud), shape.lit & shape.rows[:, None]
    if not counted.any():
        raise DataError("no point lies on the true shape: check the item's pose, light and exposure")
    vertices, faces = np.asarray(shape.mesh.vertices, np.float64), np.asarray(shape.mesh.faces, np.int64)
    square = igl.point_mesh_squared_distance(cloud.points[counted].astype(np.float64), vertices, faces)[0]
    to_cloud = distances_from_cloud(shape.samples, cloud, shape.seen[v, u])
    interval_shares = (
        {axis: widest_interval_share(bounds, axis, size) for axis in plan.axes} if bounds else None
    )
    risk = order_risk(decoded, plan, size, interval_shares)[v[counted], u[counted]]
    return MeasuredFigures(
        distance_um=1e3 * float(np.sqrt(square).mean() + to_cloud.mean() + shape.unsampled_mm) / 2.0,
        noise_um=1e3 * float(np.median(cloud.sigma_noise_mm[counted])),
        completeness=float(np.count_nonzero(lit[v, u]) / max(1, np.count_nonzero(lit))),
        wrong_order=float(np.nanmean(risk)),
    )
