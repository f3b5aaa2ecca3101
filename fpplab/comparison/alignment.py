"""Moving a true mesh onto a measured cloud: rigid, point to plane, robust against what is not the mesh.

Iterated closest points with the point-to-plane error (Chen and Medioni, 1992) and Huber's
weights, from the given pose; when that ends far off, from the 24 ways in which the principal
axes of mesh and cloud can lie on each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations, product

import igl
import numpy as np
import trimesh
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.core.errors import DataError
from fpplab.core.geometry import RigidTransform

COARSE_POINTS = 2_000
FINE_POINTS = 20_000
COARSE_ROUNDS = 20
FINE_ROUNDS = 60
REACH, NARROWER = 0.05, 0.7
"""Of a search from afar: up to where points count in full, and by how much less with every round."""
BEFORE = 0.05
"""How far before the mesh, as the camera sees it, a cloud is first laid, in sizes of the mesh."""
STILL = 1e-7
"""Smallest motion that goes on, in rad and in sizes of the mesh."""
FAR, SURE = 0.01, 3e-4
"""Mean distance, in sizes of the mesh, from which a pose is not the sought one, and up to which no better one
is looked for: where a part is nearly its own image, wrong poses are not far."""
DETAIL, SIDE_POINTS = 0.004, 400_000
"""Sizes of the mesh below which it is not asked which side of it is seen, and points that tell the side."""
HUBER = 1.345
TRIMMED, WHOLE = 0.8, 0.97
"""Share of the cloud, the nearest of it, that a pose is judged by; the rest may be something else. A sure one
is agreed on by all but flying points: what is small on a part tells poses apart."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """`T_camera_mesh`, and how well it fits: rms_um over the points that are not outliers."""

    transform: RigidTransform
    rms_um: float
    iterations: int

    def summary(self) -> dict[str, object]:
        """Plain values: rotation vector in degrees, translation in mm."""
        return {
            "rotation_deg": np.degrees(self.transform.rotation_vector).tolist(),
            "translation_mm": self.transform.translation.tolist(),
            "rms_um": self.rms_um,
            "iterations": self.iterations,
        }


def align_mesh(points: Floats, mesh: trimesh.Trimesh, seed: int = 0) -> Alignment:
    """`T_camera_mesh` that brings the mesh onto the points (N, 3), both in mm.

    The points are taken as seen from the origin, so that they lie on the mesh's outer side.
    Raises `DataError` when no pose brings them together.
    """
    random = np.random.default_rng(seed)
    fine, coarse = (_thinned(points, n, random) for n in (FINE_POINTS, COARSE_POINTS))
    target = AlignmentMesh(mesh)
    best = refine(coarse, target, RigidTransform.identity(), COARSE_ROUNDS)
    if target.misfit(coarse, best[0], WHOLE) > SURE * target.size:
        starts = _axis_poses(coarse, mesh, random)
        ends = [refine(coarse, target, start, COARSE_ROUNDS, REACH) for start in starts]
        best = min([best, *ends], key=lambda end: target.misfit(coarse, end[0]))
    pose, rounds = refine(fine, target, best[0], FINE_ROUNDS)
    if target.misfit(fine, pose) >= FAR * target.size:
        raise DataError(
            "alignment: no pose brings the mesh onto the cloud; crop the cloud to the part, check that both "
            "are in mm, or place the mesh roughly by hand"
        )
    residuals = np.abs(target.residuals(fine, pose)[0])
    kept = residuals <= np.quantile(residuals, TRIMMED)
    rms_um = float(np.sqrt(np.mean(residuals[kept] ** 2)) * 1e3)
    return Alignment(pose.inverse(), rms_um, best[1] + rounds)


class AlignmentMesh:
    """The mesh as planes to approach; poses here are `T_mesh_camera`."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.vertices = np.ascontiguousarray(mesh.vertices, np.float64)
        self.faces = np.ascontiguousarray(mesh.faces, np.int64)
        self.normals = np.asarray(mesh.face_normals, np.float64)
        self.size = float(np.linalg.norm(mesh.extents))
        self._mesh = mesh

    @cached_property
    def sides(self) -> _Sides:
        """Which way it faces where."""
        return _Sides(self._mesh, DETAIL * self.size)

    def residuals(self, points: Floats, pose: RigidTransform) -> tuple[Floats, Floats, Floats]:
        """Point-to-plane distances (N,), the placed points (N, 3) and their planes' normals (N, 3)."""
        placed = pose.apply(points)
        _, face, foot = igl.point_mesh_squared_distance(placed, self.vertices, self.faces)
        normals = self.normals[face]
        return np.einsum("ij,ij->i", placed - foot, normals), placed, normals

    def misfit(self, points: Floats, pose: RigidTransform, share: float = TRIMMED) -> float:
        """Mean distance of the nearest; a face seen from behind counts as far as the mesh is large."""
        placed = pose.apply(points)
        square, face, foot = igl.point_mesh_squared_distance(placed, self.vertices, self.faces)
        towards, side = pose.translation - placed, self.sides.at(foot, self.normals[face])
        behind = np.einsum("ij,ij->i", towards, side) < 0.0
        distances = np.where(behind, self.size, np.sqrt(square))
        return float(np.sort(distances)[: int(np.ceil(share * len(distances)))].mean())


class _Sides:
    """Which way a surface faces, for who overlooks detail: printed layers have grooves with undersides."""

    def __init__(self, mesh: trimesh.Trimesh, detail_mm: float) -> None:
        self._detail = detail_mm
        points, faces = trimesh.sample.sample_surface(mesh, SIDE_POINTS, seed=0)
        cells, cell = np.unique(self._cells(points), return_inverse=True)
        self._known = cells
        self._facing = np.zeros((len(cells), 3))
        np.add.at(self._facing, cell, mesh.face_normals[faces])

    def at(self, points: Floats, otherwise: Floats) -> Floats:
        """Directions (N, 3) at points of the surface; `otherwise` where none of it was sampled."""
        cells = self._cells(points)
        place = np.minimum(np.searchsorted(self._known, cells), len(self._known) - 1)
        known = self._known[place] == cells
        return np.where(known[:, None], self._facing[place], otherwise)

    def _cells(self, points: Floats) -> NDArray[np.int64]:
        """One number for every cell, unique within 2^20 cells along each axis."""
        i = np.floor(np.asarray(points) / self._detail).astype(np.int64) + (1 << 19)
        return np.asarray((i[:, 0] << 40) + (i[:, 1] << 20) + i[:, 2])


def _thinned(points: Floats, count: int, random: np.random.Generator) -> Floats:
    if len(points) <= count:
        return np.asarray(points, np.float64)
    return np.asarray(points[random.choice(len(points), count, replace=False)], np.float64)


def refine(
    points: Floats, target: AlignmentMesh, pose: RigidTransform, rounds: int, reach: float = 1e-9
) -> tuple[RigidTransform, int]:
    """`T_mesh_camera` from a pose near it, for points (N, 3) in mm, and the rounds it took.

    reach: distance in sizes of the mesh up to which points count in full at first, however near the others
    are: else a plate that lies right lets what stands on it nowhere.
    """
    for done in range(rounds):
        distance, placed, normals = target.residuals(points, pose)
        scale = max(1.4826 * float(np.median(np.abs(distance))), reach * NARROWER**done * target.size, 1e-12)
        weight = np.minimum(1.0, HUBER * scale / np.maximum(np.abs(distance), 1e-12))
        centre = placed.mean(axis=0)
        rows = np.hstack([np.cross(placed - centre, normals) / target.size, normals])
        matrix, right = rows.T @ (rows * weight[:, None]), -rows.T @ (weight * distance)
        # What the planes leave free, as a plate does along itself, must not move.
        step = np.linalg.lstsq(matrix, right, rcond=1e-9)[0]
        turn = RigidTransform.from_vectors(step[:3] / target.size, np.zeros(3))
        pose = RigidTransform(turn.rotation, centre + step[3:] - turn.rotation @ centre) @ pose
        if np.linalg.norm(step) < STILL * target.size:
            return pose, done + 1
    return pose, rounds


def _axis_poses(points: Floats, mesh: trimesh.Trimesh, random: np.random.Generator) -> list[RigidTransform]:
    """The proper rotations that lay the cloud's principal axes on the mesh's, middle on middle.

    Of the mesh the middle of what then faces the camera, and the cloud a little before it: from within a
    plate the way to its wrong side is as short.
    """
    surface, faces = trimesh.sample.sample_surface(mesh, COARSE_POINTS, seed=int(random.integers(1 << 31)))
    surface, normals = np.asarray(surface), np.asarray(mesh.face_normals[faces])
    from_axes, to_axes = _axes(points), _axes(surface)
    from_middle = _middle(points, from_axes)
    view = from_middle / np.linalg.norm(from_middle)
    before = BEFORE * float(np.linalg.norm(mesh.extents)) * view
    poses = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        rotation = (to_axes[:, list(order)] * np.array(signs)) @ from_axes.T
        if np.linalg.det(rotation) > 0.0:
            seen = surface[normals @ (rotation @ view) < 0.0]
            to_middle = _middle(seen if len(seen) else surface, to_axes)
            poses.append(RigidTransform(rotation, to_middle - rotation @ (from_middle + before)))
    return poses


def _axes(points: Floats) -> Floats:
    """Principal axes in columns."""
    return np.asarray(np.linalg.eigh(np.cov((points - np.median(points, axis=0)).T))[1])


def _middle(points: Floats, axes: Floats) -> Floats:
    """Of the box along these axes."""
    along = points @ axes
    return np.asarray(axes @ ((along.min(axis=0) + along.max(axis=0)) / 2.0))
