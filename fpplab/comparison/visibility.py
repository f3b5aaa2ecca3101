"""What a device sees of a mesh: its image, the sides that face it, and what lies before them."""

from __future__ import annotations

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Mask

OCCLUDED_MM = 0.02
"""A surface this much nearer hides a point; less is the rounding of single-precision rays."""


class RayTracedShape:
    """A mesh in mm in the camera's frame, ready for rays."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.triangles = np.asarray(mesh.triangles, np.float64)
        self.normals = np.asarray(mesh.face_normals, np.float64)
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, self.triangles.astype(np.float32))

    def facing(self, centre: Floats) -> Mask:
        """The faces (F,) whose outward side is towards a point (3,): the same for all of a flat face."""
        towards = np.asarray(centre) - self.triangles[:, 0]
        return np.asarray(np.einsum("ij,ij->i", towards, self.normals) > 0.0)

    def inclination_deg(self, centre: Floats, points: Floats, faces: NDArray[np.int64]) -> Floats:
        """Angle in degrees (N,) between the view from a centre and the outward normal at points of faces."""
        towards = np.asarray(centre) - points
        cosine = np.einsum("ij,ij->i", towards, self.normals[faces]) / np.linalg.norm(towards, axis=1)
        return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))

    def first(self, centre: Floats, directions: Floats) -> NDArray[np.int64]:
        """The face (N,) that rays from a centre along directions (N, 3) meet first, -1 without."""
        return np.asarray(self._scene.run(*_rays(centre, directions), query="INTERSECT"), np.int64)

    def depth(self, centre: Floats, directions: Floats) -> Floats:
        """Distance in mm (N,) from the centre to the first hit along unit directions (N, 3), inf without."""
        # The bindings answer misses with the largest length they start from.
        hits = self._scene.run(*_rays(centre, directions), query="DISTANCE")
        return np.where(hits < 1e30, hits, np.inf).astype(np.float64)

    def lit(self, centre: Floats, points: Floats) -> Mask:
        """Which points (N, 3) of the surface have nothing between them and a centre (3,)."""
        rays = points - centre
        lengths = np.linalg.norm(rays, axis=1)
        return np.asarray(self.depth(centre, rays / lengths[:, None]) >= lengths - OCCLUDED_MM)


def _rays(centre: Floats, directions: Floats) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Origins and directions (N, 3) of rays from a centre, as the bindings take them."""
    origins = np.broadcast_to(np.asarray(centre, np.float32), directions.shape)
    return np.ascontiguousarray(origins), directions.astype(np.float32)
