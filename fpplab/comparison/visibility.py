"""Visibility of a mesh from a device: the faces towards it, the first hits of rays, and occlusion."""

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Mask


class RayTracedShape:
    """A mesh prepared for ray tracing."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.triangles = np.asarray(mesh.triangles, np.float64)
        self.normals = np.asarray(mesh.face_normals, np.float64)
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, self.triangles.astype(np.float32))

    def facing(self, centre: Floats) -> Mask:
        # centre (3,) mm; returns (F,)
        towards = np.asarray(centre) - self.triangles[:, 0]
        return np.asarray(np.einsum("ij,ij->i", towards, self.normals) > 0.0)

    def inclination_deg(self, centre: Floats, points: Floats, faces: NDArray[np.int64]) -> Floats:
        # centre (3,) mm; points (N, 3) mm; faces (N,); returns (N,) degrees
        towards = np.asarray(centre) - points
        cosine = np.einsum("ij,ij->i", towards, self.normals[faces]) / np.linalg.norm(towards, axis=1)
        return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))

    def first_face(self, centre: Floats, directions: Floats) -> NDArray[np.int64]:
        # centre (3,) mm; directions (N, 3); returns (N,)
        return np.asarray(self._scene.run(*_rays(centre, directions), query="INTERSECT"), np.int64)

    def depth(self, centre: Floats, directions: Floats) -> Floats:
        # centre (3,) mm, or (N, 3) mm for each ray; directions (N, 3); returns (N,) mm
        # For a miss the bindings return the ray's initial length, which is huge.
        hits = self._scene.run(*_rays(centre, directions), query="DISTANCE")
        return np.where(hits < 1e30, hits, np.inf).astype(np.float64)

    def unoccluded(self, centre: Floats, points: Floats) -> Mask:
        # centre (3,) mm; points (N, 3) mm; returns (N,)
        rays = points - centre
        lengths = np.linalg.norm(rays, axis=1)
        directions, first = rays / lengths[:, None], np.zeros(len(rays))
        # Rays are of single precision: those of a far lamp would hit the point's own surface a little earlier
        # or later, so they start where they come near the mesh.
        if lengths.size and np.spacing(np.float32(lengths.max())) > 1e-3:
            middle = self.triangles.mean(axis=(0, 1))
            radius = float(np.linalg.norm(self.triangles - middle, axis=-1).max())
            first = np.maximum(lengths - radius - np.linalg.norm(points - middle, axis=1), 0.0)
        starts = centre + first[:, None] * directions
        # A surface that is nearer by 0.02 mm or less is the point's own.
        return np.asarray(self.depth(starts, directions) >= lengths - first - 0.02)


def _rays(centre: Floats, directions: Floats) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    origins = np.broadcast_to(np.asarray(centre, np.float32), directions.shape)
    return np.ascontiguousarray(origins), directions.astype(np.float32)
