"""Whether cloud and true shape are both in mm: a factor between their sizes that a unit explains is named."""

from dataclasses import dataclass

import igl
import numpy as np
import trimesh

from fpplab.clouds.files import MIN_SIZE_MM
from fpplab.comparison.alignment import LIMITS as ALIGNMENT
from fpplab.comparison.alignment import align_mesh
from fpplab.core.conventions import Floats
from fpplab.core.errors import DataError

UNITS_MM = {"m": 1000.0, "inches": 25.4, "cm": 10.0}


@dataclass(frozen=True)
class UnitLimits:
    """Limits by which sizes are taken for those of another unit."""

    min_size_mm: float = MIN_SIZE_MM  # size of cloud and mesh below which they cannot be in mm
    max_size_mm: float = 2000.0  # of parts (chosen); what is larger may be in µm
    max_size_ratio: float = 50.0  # of cloud and mesh, beyond which they cannot be in the same unit (chosen)
    usual_size_ratio: tuple[float, float] = (0.3, 3.0)
    """Size of the cloud, in sizes of the mesh: a part of it, or with surroundings. Chosen."""

    def is_usual(self, ratio: float) -> bool:
        low, high = self.usual_size_ratio
        return low < ratio < high


LIMITS = UnitLimits()


def check_units(points: Floats, mesh: trimesh.Trimesh, seed: int = 0) -> None:
    """Raise `DataError` where cloud and mesh cannot be in the same unit, and fit in different ones."""
    # points (N, 3) mm
    low, high = np.quantile(points, (0.01, 0.99), axis=0)
    cloud_mm, mesh_mm = float(np.linalg.norm(high - low)), float(np.linalg.norm(mesh.extents))
    sizes = f"true mesh: is {mesh_mm:.3g} mm across, and the cloud {cloud_mm:.3g} mm"
    if max(cloud_mm, mesh_mm) < LIMITS.min_size_mm:
        raise DataError(f"{sizes}; both must be in mm: of m, multiply all coordinates by 1000")
    ratio = cloud_mm / max(mesh_mm, 1e-12)
    small, factor = ("mesh", ratio) if ratio > 1.0 else ("cloud", 1.0 / max(ratio, 1e-12))
    for unit, unit_mm in sorted(UNITS_MM.items(), key=lambda item: abs(np.log(factor / item[1]))):
        scale = unit_mm if small == "mesh" else 1.0 / unit_mm
        if not LIMITS.is_usual(ratio / scale) or LIMITS.is_usual(ratio):
            continue
        scaled = trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False)
        if _fits(points, scaled, seed) and not _fits(points, mesh, seed):
            what = f"{small} is {unit_mm:g} times too small, as between {unit} and mm", "multiplied"
            if unit == "m" and max(cloud_mm, mesh_mm) > LIMITS.max_size_mm:
                large = "cloud" if small == "mesh" else "mesh"
                what = f"{large} is 1000 times too large, as between µm and mm", "divided"
            raise DataError(
                f"{sizes}: the {what[0]}, and fits if its coordinates are {what[1]} by that; "
                "both must be in mm"
            )
    if not 1 / LIMITS.max_size_ratio < ratio < LIMITS.max_size_ratio:
        raise DataError(f"{sizes}; both must be in mm")


def _fits(points: Floats, mesh: trimesh.Trimesh, seed: int) -> bool:
    chosen = np.random.default_rng(seed).permutation(len(points))[: ALIGNMENT.coarse_points]
    if _lie_on(points[chosen], mesh):
        return True
    try:
        pose = align_mesh(points, mesh, seed).transform.inverse()
    except DataError:
        return False
    return _lie_on(pose.apply(points[chosen]), mesh)


def _lie_on(points: Floats, mesh: trimesh.Trimesh) -> bool:
    square = igl.point_mesh_squared_distance(
        points, np.ascontiguousarray(mesh.vertices, np.float64), np.ascontiguousarray(mesh.faces, np.int64)
    )[0]
    # Of the smaller one: a cloud that is far too small lies on any shape.
    limit_mm = ALIGNMENT.max_misfit * min(map(np.linalg.norm, (mesh.extents, np.ptp(points, axis=0))))
    return bool(np.quantile(np.sqrt(square), ALIGNMENT.good_share) <= limit_mm)
