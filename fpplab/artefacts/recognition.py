"""Recognises an artefact by its mesh, so that its file needs no label."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from fpplab.artefacts.base import Artefact
from fpplab.artefacts.catalogue import artefact_types
from fpplab.core.geometry import RigidTransform

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, eq=False)
class PlacedArtefact:
    """An artefact, and where it is in the frame of a mesh."""

    artefact: Artefact  # with its lengths
    pose: RigidTransform  # T_mesh_artefact, in mm


def recognise(mesh: trimesh.Trimesh) -> PlacedArtefact | None:
    for shape in artefact_types().values():
        artefact = shape()
        drawn = np.asarray(artefact.mesh().triangles, np.float64).reshape(-1, 3)
        triangles = np.asarray(mesh.triangles, np.float64).reshape(-1, 3)
        if len(drawn) != len(triangles):
            continue
        turn, _ = Rotation.align_vectors(triangles - triangles.mean(axis=0), drawn - drawn.mean(axis=0))
        rotation = turn.as_matrix()
        pose = RigidTransform(rotation, triangles.mean(axis=0) - rotation @ drawn.mean(axis=0))
        if np.abs(pose.apply(drawn) - triangles).max() <= 1e-3:  # mm, chosen: files have 32 bit floats
            return PlacedArtefact(artefact, pose)
    return None
