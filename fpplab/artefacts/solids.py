"""Solids between trimesh and manifold3d, the library that unites and slices them."""

from __future__ import annotations

import numpy as np
import trimesh
from manifold3d import Manifold, Mesh64


def to_manifold(mesh: trimesh.Trimesh) -> Manifold:
    """The solid that a mesh encloses; its `status` says whether it encloses one."""
    corners = np.array(mesh.vertices, np.float64, order="C")
    return Manifold(Mesh64(corners, np.array(mesh.faces, np.uint64, order="C")))


def to_trimesh(solid: Manifold) -> trimesh.Trimesh:
    """The surface of a solid, corners and faces as they are."""
    parts = solid.to_mesh64()
    return trimesh.Trimesh(np.array(parts.vert_properties[:, :3]), parts.tri_verts, process=False)
