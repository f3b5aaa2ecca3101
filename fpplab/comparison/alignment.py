"""Rigid alignment of a true mesh to a cloud by point-to-plane ICP with Huber's weights.

It starts from the given pose; if that ends far from the mesh, from the 24 ways in which the principal axes of
mesh and cloud can coincide.
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
from fpplab.core.robust import huber_weights, robust_spread


@dataclass(frozen=True)
class AlignmentLimits:
    """Limits of the alignment. Sizes of the mesh are the diagonal of its bounding box."""

    coarse_points: int = 2_000  # points that a pose is searched with (chosen)
    fine_points: int = 20_000  # points that the result is refined with (chosen)
    coarse_rounds: int = 20  # iterations of the search (chosen)
    fine_rounds: int = 60  # iterations of the refinement (chosen)
    search_distance: float = 0.05
    """In sizes of the mesh, up to which points have full weight at first (chosen)"""
    search_decay: float = 0.7  # factor of that distance from one iteration to the next (chosen)
    start_offset: float = 0.05  # how far in front of the mesh a cloud is first placed, in its sizes (chosen)
    converged_step: float = 1e-7  # in rad and in sizes of the mesh (chosen: 0.01 µm on a part of 100 mm)
    max_misfit: float = 0.01  # mean distance, in sizes of the mesh, from which a pose is rejected (chosen)
    good_misfit: float = 3e-4
    """Mean distance in sizes of the mesh. Chosen small: wrong poses of symmetric parts are near."""
    detail_size: float = 0.004  # in sizes of the mesh (chosen above the grooves between printed layers)
    direction_points: int = 400_000  # samples of the surface (chosen: several in every such feature)
    judged_share: float = 0.8  # of the cloud, its nearest points, by which a pose is judged (chosen)
    good_share: float = 0.97
    """Of the cloud that a good pose must fit (chosen: small features distinguish poses)"""


LIMITS = AlignmentLimits()


@dataclass(frozen=True, eq=False)
class Alignment:
    """The result of an alignment."""

    transform: RigidTransform  # T_camera_mesh, in mm
    rms_um: float  # root mean square distance in µm of the nearest `LIMITS.judged_share` of the points
    iterations: int  # number of iterations

    def summary(self) -> dict[str, object]:
        return {
            "rotation_deg": np.degrees(self.transform.rotation_vector).tolist(),
            "translation_mm": self.transform.translation.tolist(),
            "rms_um": self.rms_um,
            "iterations": self.iterations,
        }


def align_mesh(points: Floats, mesh: trimesh.Trimesh, seed: int = 0) -> Alignment:
    # The points are assumed to be seen from the origin, so that they lie on the mesh's outer side.
    # points (N, 3) mm
    random = np.random.default_rng(seed)
    fine, coarse = (_subsample(points, n, random) for n in (LIMITS.fine_points, LIMITS.coarse_points))
    target = AlignmentMesh(mesh)
    best = refine_pose(coarse, target, RigidTransform.identity(), LIMITS.coarse_rounds)
    if target.misfit(coarse, best[0], LIMITS.good_share) > LIMITS.good_misfit * target.size:
        starts = _axis_poses(coarse, mesh, random)
        ends = [
            refine_pose(coarse, target, start, LIMITS.coarse_rounds, LIMITS.search_distance)
            for start in starts
        ]
        best = min([best, *ends], key=lambda end: target.misfit(coarse, end[0]))
    pose, rounds = refine_pose(fine, target, best[0], LIMITS.fine_rounds)
    if target.misfit(fine, pose) >= LIMITS.max_misfit * target.size:
        raise DataError(
            "alignment: no pose brings the mesh onto the cloud; crop the cloud to the part, check that both "
            "are in mm, or place the mesh roughly by hand"
        )
    residuals = np.abs(target.residuals(fine, pose)[0])
    kept = residuals <= np.quantile(residuals, LIMITS.judged_share)
    rms_um = float(np.sqrt(np.mean(residuals[kept] ** 2)) * 1e3)
    return Alignment(pose.inverse(), rms_um, best[1] + rounds)


class AlignmentMesh:
    """A mesh prepared for alignment; poses here are T_mesh_camera."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.vertices = np.ascontiguousarray(mesh.vertices, np.float64)
        self.faces = np.ascontiguousarray(mesh.faces, np.int64)
        self.normals = np.asarray(mesh.face_normals, np.float64)
        self.size = float(np.linalg.norm(mesh.extents))
        self._mesh = mesh

    @cached_property
    def directions(self) -> _SurfaceDirections:
        """Directions that the surface faces, ignoring features below `LIMITS.detail_size`."""
        return _SurfaceDirections(self._mesh, LIMITS.detail_size * self.size)

    def residuals(self, points: Floats, pose: RigidTransform) -> tuple[Floats, Floats, Floats]:
        """Compute the distances of points from the planes of their nearest faces."""
        # points (N, 3) mm; returns distances (N,) mm, placed (N, 3) mm, normals (N, 3)
        placed = pose.apply(points)
        _, face, foot = igl.point_mesh_squared_distance(placed, self.vertices, self.faces)
        normals = self.normals[face]
        return np.einsum("ij,ij->i", placed - foot, normals), placed, normals

    def misfit(self, points: Floats, pose: RigidTransform, share: float = LIMITS.judged_share) -> float:
        # A point on a face that is seen from behind counts with the size of the mesh as its distance.
        # points (N, 3) mm
        placed = pose.apply(points)
        square, face, foot = igl.point_mesh_squared_distance(placed, self.vertices, self.faces)
        towards, side = pose.translation - placed, self.directions.at(foot, self.normals[face])
        behind = np.einsum("ij,ij->i", towards, side) < 0.0
        distances = np.where(behind, self.size, np.sqrt(square))
        return float(np.sort(distances)[: int(np.ceil(share * len(distances)))].mean())


class _SurfaceDirections:
    """Directions that a surface faces, ignoring details such as the grooves between printed layers."""

    def __init__(self, mesh: trimesh.Trimesh, detail_mm: float) -> None:
        self._detail = detail_mm
        points, faces = trimesh.sample.sample_surface(mesh, LIMITS.direction_points, seed=0)
        cells, cell = np.unique(self._cells(points), return_inverse=True)
        self._sampled_cells = cells
        self._facing = np.zeros((len(cells), 3))
        np.add.at(self._facing, cell, mesh.face_normals[faces])

    def at(self, points: Floats, otherwise: Floats) -> Floats:
        """Look up directions (N, 3) at points of the surface; `otherwise` where it was not sampled."""
        cells = self._cells(points)
        place = np.minimum(np.searchsorted(self._sampled_cells, cells), len(self._sampled_cells) - 1)
        sampled = self._sampled_cells[place] == cells
        return np.where(sampled[:, None], self._facing[place], otherwise)

    def _cells(self, points: Floats) -> NDArray[np.int64]:
        """Compute the cell number of points, unique within 2^20 cells along each axis."""
        i = np.floor(np.asarray(points) / self._detail).astype(np.int64) + (1 << 19)
        return np.asarray((i[:, 0] << 40) + (i[:, 1] << 20) + i[:, 2])


def _subsample(points: Floats, count: int, random: np.random.Generator) -> Floats:
    if len(points) <= count:
        return np.asarray(points, np.float64)
    return np.asarray(points[random.choice(len(points), count, replace=False)], np.float64)


def refine_pose(
    points: Floats,
    target: AlignmentMesh,
    pose: RigidTransform,
    rounds: int,
    full_weight_distance: float = 1e-9,
) -> tuple[RigidTransform, int]:
    # points (N, 3) mm
    for done in range(rounds):
        distance, placed, normals = target.residuals(points, pose)
        spread = max(robust_spread(distance), full_weight_distance * LIMITS.search_decay**done * target.size)
        weight = huber_weights(distance, spread)
        centre = placed.mean(axis=0)
        rows = np.hstack([np.cross(placed - centre, normals) / target.size, normals])
        matrix, right = rows.T @ (rows * weight[:, None]), -rows.T @ (weight * distance)
        # Motions that the planes do not determine, such as a plate's within its plane, stay zero.
        step = np.linalg.lstsq(matrix, right, rcond=1e-9)[0]
        turn = RigidTransform.from_vectors(step[:3] / target.size, np.zeros(3))
        pose = RigidTransform(turn.rotation, centre + step[3:] - turn.rotation @ centre) @ pose
        if np.linalg.norm(step) < LIMITS.converged_step * target.size:
            return pose, done + 1
    return pose, rounds


def _axis_poses(points: Floats, mesh: trimesh.Trimesh, random: np.random.Generator) -> list[RigidTransform]:
    # The mesh's centre is that of its surface facing the camera, and the cloud is placed slightly in front of
    # it: from inside a plate, its wrong side would be as near as the right one.
    surface, faces = trimesh.sample.sample_surface(
        mesh, LIMITS.coarse_points, seed=int(random.integers(1 << 31))
    )
    surface, normals = np.asarray(surface), np.asarray(mesh.face_normals[faces])
    from_axes, to_axes = _axes(points), _axes(surface)
    from_middle = _bounding_box_centre(points, from_axes)
    view = from_middle / np.linalg.norm(from_middle)
    before = LIMITS.start_offset * float(np.linalg.norm(mesh.extents)) * view
    poses = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        rotation = (to_axes[:, list(order)] * np.array(signs)) @ from_axes.T
        if np.linalg.det(rotation) > 0.0:
            visible = surface[normals @ (rotation @ view) < 0.0]
            to_middle = _bounding_box_centre(visible if len(visible) else surface, to_axes)
            poses.append(RigidTransform(rotation, to_middle - rotation @ (from_middle + before)))
    return poses


def _axes(points: Floats) -> Floats:
    return np.asarray(np.linalg.eigh(np.cov((points - np.median(points, axis=0)).T))[1])


def _bounding_box_centre(points: Floats, axes: Floats) -> Floats:
    along = points @ axes
    return np.asarray(axes @ ((along.min(axis=0) + along.max(axis=0)) / 2.0))
