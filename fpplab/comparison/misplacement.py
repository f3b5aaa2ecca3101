"""Whether a mesh that is far from a cloud only stands elsewhere: then an alignment is what is missing."""

from dataclasses import dataclass

import igl
import numpy as np
import trimesh

from fpplab.clouds import Cloud
from fpplab.comparison.alignment import LIMITS as ALIGNMENT
from fpplab.comparison.alignment import align_mesh
from fpplab.core.conventions import Floats
from fpplab.core.errors import DataError


@dataclass(frozen=True)
class MisplacementLimits:
    """Limits by which a mesh counts as misplaced."""

    min_distance: float = 2e-3
    """Of cloud and mesh, in sizes of the mesh, beyond which an alignment is tried (chosen)"""
    max_remaining_share: float = 0.2  # share of that distance that may remain after the alignment (chosen)


LIMITS = MisplacementLimits()


@dataclass(frozen=True)
class Misplacement:
    """A mesh that fits the cloud, but stands elsewhere."""

    before_mm: float  # root mean square distance of the nearest points, `AlignmentLimits.judged_share`
    after_mm: float  # the same after a rigid alignment

    def describe(self) -> str:
        return (
            f"the mesh does not stand where the cloud lies: the points are {self.before_mm:.3g} mm from it, "
            f"but {self.after_mm:.3g} mm after a rigid alignment; compare with --align"
        )


def find_misplacement(cloud: Cloud, mesh: trimesh.Trimesh, seed: int = 0) -> Misplacement | None:
    """Find out whether a rigid alignment explains a large distance between a cloud and a mesh."""
    points = np.asarray(cloud.coordinates, np.float64)
    before = _distance_mm(points, mesh, seed)
    if before <= LIMITS.min_distance * float(np.linalg.norm(mesh.extents)):
        return None
    try:
        alignment = align_mesh(points, mesh, seed)
    except DataError:
        return None
    after = alignment.rms_um / 1e3
    return Misplacement(before, after) if after <= LIMITS.max_remaining_share * before else None


def _distance_mm(points: Floats, mesh: trimesh.Trimesh, seed: int) -> float:
    """Root mean square distance in mm of the nearest `AlignmentLimits.judged_share` of some of the points."""
    chosen = np.random.default_rng(seed).permutation(len(points))[: ALIGNMENT.coarse_points]
    square = igl.point_mesh_squared_distance(
        points[chosen],
        np.ascontiguousarray(mesh.vertices, np.float64),
        np.ascontiguousarray(mesh.faces, np.int64),
    )[0]
    return float(np.sqrt(np.sort(square)[: int(np.ceil(ALIGNMENT.judged_share * len(square)))].mean()))
