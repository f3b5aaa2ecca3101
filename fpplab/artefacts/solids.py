"""Conversion of solids between trimesh and manifold3d, the library that unites and slices them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from manifold3d import Manifold, Mesh64

if TYPE_CHECKING:
    import trimesh


def to_manifold(mesh: trimesh.Trimesh) -> Manifold:
    corners = np.array(mesh.vertices, np.float64, order="C")
    return Manifold(Mesh64(corners, np.array(mesh.faces, np.uint64, order="C")))


def to_trimesh(solid: Manifold) -> trimesh.Trimesh:
    import trimesh  # most of a second that listing names does not need

    parts = solid.to_mesh64()
    return trimesh.Trimesh(np.array(parts.vert_properties[:, :3]), parts.tri_verts, process=False)
