"""Telling by a mesh which artefact it is, so that its file needs no label."""

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
    """Recognise an artefact or standard of usual size by its mesh, wherever that is placed."""
    for shape in artefact_types().values():
        known = shape()
        drawn = np.asarray(known.mesh().triangles, np.float64).reshape(-1, 3)
        seen = np.asarray(mesh.triangles, np.float64).reshape(-1, 3)
        if len(drawn) != len(seen):
            continue
        turn, _ = Rotation.align_vectors(seen - seen.mean(axis=0), drawn - drawn.mean(axis=0))
        rotation = turn.as_matrix()
        pose = RigidTransform(rotation, seen.mean(axis=0) - rotation @ drawn.mean(axis=0))
        if np.abs(pose.apply(drawn) - seen).max() <= 1e-3:  # mm, chosen: files have 32 bit floats
            return PlacedArtefact(known, pose)
    return None
