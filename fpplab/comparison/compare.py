"""How far a measured cloud is from the true shape.

Two kinds of figure. The SMCD is the paper's: the mean distance to the nearest point of the
other set, averaged over both ways. It compares samples, so even a perfect measurement scores
the spacing of the samples; `smcd_floor_um` says how much that is. The surface figures compare
with surfaces (cloud to true mesh, truth to the surface over the pixel grid) and have no floor.

What counts is fixed before any distance is known. Of the truth: what both devices see, that is
inside both images, with nothing between, inclined to both views by no more than `STEEPEST_DEG`
(beyond it the grid of pixels resolves no surface). Of the cloud: every point whose
pixel looks at the true shape, wherever the point itself came to lie; outliers are counted and
are part of every mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.clouds.pixelgrid import STEEPEST_DEG
from fpplab.comparison.alignment import Alignment, align_mesh
from fpplab.comparison.neighbours import nearest
from fpplab.comparison.surfaces import distance_to_surface
from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.conventions import Floats, Map, Mask
from fpplab.core.errors import ConfigError, DataError

DENSITY_PER_MM2 = 200.0
OUTLIER_MM = 1.0
NEAR_MM = 0.5
"""True surface counts as measured when reconstructed surface lies this near."""
LARGEST_RATIO = 50.0
"""Cloud and mesh whose sizes differ by more are not in the same unit."""
_UM = 1e3


@dataclass(frozen=True, eq=False)
class Comparison:
    """Distances between a cloud and a true mesh, lengths as their names say.

    smcd_um, smcd_floor_um: see the module. surface_smcd_um: mean of the mean distances cloud to
    mesh and visible truth to reconstructed surface, None when the cloud knows no pixels and so
    no surface. surface_rms_um, surface_p95_um: of the distances cloud to mesh. completeness: share of
    the visible truth with reconstructed surface (else points) within `near_mm`. outliers: points
    further than `outlier_mm`, which are in all means. visible_share: visible share of the mesh's area.
    points: how many count; beside: points whose pixel does not look at the true shape, which do not.
    restricted: whether a calibration said what is visible. alignment: the mesh's motion, if any.

    distances_mm: float32 (N,) of every point of the cloud, signed, positive outside the true shape.
    counted: bool (N,).
    """

    smcd_um: float
    smcd_floor_um: float
    surface_smcd_um: float | None
    surface_rms_um: float
    surface_p95_um: float
    completeness: float
    outliers: int
    visible_share: float
    points: int
    beside: int
    density_per_mm2: float
    outlier_mm: float
    near_mm: float
    restricted: bool
    alignment: Alignment | None
    distances_mm: Map
    counted: Mask

    def summary(self) -> dict[str, object]:
        """The figures as plain values for JSON."""
        arrays = ("distances_mm", "counted", "alignment")
        figures = {name: value for name, value in vars(self).items() if name not in arrays}
        return figures | {"alignment": self.alignment.summary() if self.alignment else None}


def mcd(a: Floats, b: Floats) -> float:
    """Mean distance from each point of a (N, 3) to its nearest in b (M, 3): the paper's eq. `mcd`."""
    return float(nearest(a, b)[0].mean())


def smcd(a: Floats, b: Floats) -> float:
    """Symmetric mean Chamfer distance, (mcd(a, b) + mcd(b, a))/2: the paper's eq. `smcd`."""
    return (mcd(a, b) + mcd(b, a)) / 2.0


def compare(
    cloud: Cloud,
    mesh: trimesh.Trimesh,
    calibration: Calibration | None = None,
    density: float = DENSITY_PER_MM2,
    seed: int = 0,
    align: bool = False,
    outlier_mm: float = OUTLIER_MM,
    near_mm: float = NEAR_MM,
) -> Comparison:
    """Compare a cloud with the true mesh, both in mm in the camera's frame.

    density: of the true mesh's samples per mm², drawn uniformly with `seed`. align: move the mesh
    onto the cloud first (`fpplab.comparison.alignment`). Without a calibration all of the mesh that faces the
    camera counts as visible, and every point of the cloud.

    Raises `ConfigError` for a density or length that is not positive, `DataError` when the mesh is
    inside out, nothing of it is visible, or no point looks at it.
    """
    for name, value in (("density", density), ("outlier_mm", outlier_mm), ("near_mm", near_mm)):
        if not (np.isfinite(value) and value > 0.0):
            raise ConfigError(f"{name}: {value:g} must be a number above 0")
    if mesh.is_watertight and mesh.volume < 0.0:
        raise DataError("true mesh: its normals point inwards; turn them outwards and export it again")
    points = cloud.points.astype(np.float64)
    _check_units(points, mesh)
    alignment = align_mesh(points, mesh, seed) if align else None
    if alignment is not None:
        mesh = mesh.copy().apply_transform(alignment.transform.matrix)
    shape = RayTracedShape(mesh)
    samples, visible_share = visible_samples(mesh, shape, calibration, density, seed)
    counted = np.ones(len(points), np.bool_) if calibration is None else _looks_at(shape, points)
    if not counted.any():
        raise DataError(
            "cloud: no point looks at the true mesh; are both in the camera's frame, or is `align` wanted?"
        )
    distances, feet = _to_mesh(points, mesh)
    measured, error = points[counted], np.abs(distances[counted])
    to_cloud = nearest(samples, measured)[0]
    to_surface = None if cloud.pixels is None else _to_surface(samples, cloud, counted)
    return Comparison(
        smcd_um=_UM * (mcd(measured, samples) + float(to_cloud.mean())) / 2.0,
        smcd_floor_um=_UM * smcd(feet[counted], samples),
        surface_smcd_um=None if to_surface is None else _UM * float(error.mean() + to_surface.mean()) / 2.0,
        surface_rms_um=_UM * float(np.sqrt(np.mean(error**2))),
        surface_p95_um=_UM * float(np.quantile(error, 0.95)),
        completeness=float(np.mean((to_cloud if to_surface is None else to_surface) <= near_mm)),
        outliers=int(np.count_nonzero(error > outlier_mm)),
        visible_share=visible_share,
        points=len(measured),
        beside=len(points) - len(measured),
        density_per_mm2=density,
        outlier_mm=outlier_mm,
        near_mm=near_mm,
        restricted=calibration is not None,
        alignment=alignment,
        distances_mm=distances.astype(np.float32),
        counted=counted,
    )


def _check_units(points: Floats, mesh: trimesh.Trimesh) -> None:
    """Refuse a mesh that cannot be in the cloud's unit: `DataError`."""
    low, high = np.quantile(points, (0.01, 0.99), axis=0)
    cloud_mm, mesh_mm = float(np.linalg.norm(high - low)), float(np.linalg.norm(mesh.extents))
    if not 1 / LARGEST_RATIO < cloud_mm / max(mesh_mm, 1e-12) < LARGEST_RATIO:
        raise DataError(
            f"true mesh: is {mesh_mm:.3g} mm across, but the cloud {cloud_mm:.3g} mm; both must be in mm"
        )


def visible_samples(
    mesh: trimesh.Trimesh,
    shape: RayTracedShape,
    calibration: Calibration | None,
    density: float,
    seed: int,
    lit: bool = True,
) -> tuple[Floats, float]:
    """Uniform samples (M, 3) of what is visible, and its share of the mesh's area.

    lit: whether the projector must see it too, and not the camera alone. Raises `DataError` when nothing is.
    """
    centres = [np.zeros(3)]
    if calibration is not None and lit:
        centres.append(calibration.projector_centre)
    facing = np.logical_and.reduce([shape.facing(centre) for centre in centres])
    area = np.asarray(mesh.area_faces) * facing
    count = int(np.ceil(density * area.sum()))
    if count == 0:
        raise DataError(
            "true mesh: no side of it faces both devices; are cloud and mesh in the camera's frame?"
        )
    samples, faces = trimesh.sample.sample_surface(mesh, count, face_weight=area, seed=seed)
    samples = np.asarray(samples, np.float64)
    seen = np.logical_and.reduce([shape.inclination_deg(c, samples, faces) <= STEEPEST_DEG for c in centres])
    if calibration is not None:
        seen &= calibration.camera.sees(samples)
        if lit:
            seen &= calibration.projector.sees(samples, calibration.T_projector_camera)
        for centre in centres:
            seen[seen] = shape.lit(centre, samples[seen])
    if not seen.any():
        raise DataError(
            "true mesh: both devices see nothing of it; are cloud and mesh in the camera's frame?"
        )
    return samples[seen], float(np.mean(seen) * area.sum() / mesh.area)


def _looks_at(shape: RayTracedShape, points: Floats) -> Mask:
    """Which points (N, 3) lie on a ray of the camera that meets the true shape."""
    directions = points / np.linalg.norm(points, axis=1)[:, None]
    return np.isfinite(shape.depth(np.zeros(3), directions))


def _to_mesh(points: Floats, mesh: trimesh.Trimesh) -> tuple[Floats, Floats]:
    """Signed distances (N,) to the mesh, positive outside, and the closest points on it (N, 3)."""
    distances, _, feet, _ = igl.signed_distance(
        points,
        np.ascontiguousarray(mesh.vertices, np.float64),
        np.ascontiguousarray(mesh.faces, np.int64),
        sign_type=igl.SignedDistanceType.SIGNED_DISTANCE_TYPE_PSEUDONORMAL,
    )
    return distances, feet


def _to_surface(samples: Floats, cloud: Cloud, counted: Mask) -> Floats:
    """Distances (M,) to the surface that the counted points span over the pixel grid."""
    vertices, faces = cloud.grid_mesh()
    faces = faces[counted[faces].all(axis=1)]
    if len(faces) == 0:
        raise DataError(
            "cloud: its points span no surface, for none are neighbours; look at the mask's settings"
        )
    return distance_to_surface(samples, vertices.astype(np.float64), faces)
