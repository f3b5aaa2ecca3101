"""Parts of one's own: solids read from mesh files, or refused with what to mend."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from fpplab.core.errors import ConfigError, DataError

SMALLEST_MM = 1.0
"""A part whose largest extent is less than this was drawn in metres: nothing as small is measured."""


def load_part(path: Path) -> trimesh.Trimesh:
    """A part from an STL, PLY or OBJ file as one closed surface facing outwards; corners in mm, in the
    frame of the file.

    Corners that coincide are joined, and the file's colours and texture are left behind.
    Raises `ConfigError` for a file that is missing or no mesh, for a surface that encloses no
    solid (`check_solid`), and for lengths that look like metres.
    """
    from fpplab.clouds import load_mesh  # half a second that making artefacts does not need

    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file; check the path")
    try:
        mesh = load_mesh(path)
    except DataError as error:
        raise ConfigError(str(error)) from error
    check_solid(mesh, str(path))
    largest = float(mesh.extents.max())
    if largest < SMALLEST_MM:
        raise ConfigError(f"{path}: looks like metres, for it is {largest:g} mm large; scale by 1000")
    return mesh


def check_solid(mesh: trimesh.Trimesh, name: str) -> None:
    """Raise `ConfigError` unless the mesh is closed and its faces are directed outwards.

    name: of the part, for the error's sentence.
    """
    if len(mesh.faces) == 0:
        raise ConfigError(f"{name}: has no faces; give the mesh of a solid")
    _, joins = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    unpaired = int((joins != 2).sum())
    if unpaired:
        raise ConfigError(
            f"{name}: is not watertight, for {unpaired} open edges do not join two faces; "
            "close its surface in a mesh editor"
        )
    if not mesh.is_winding_consistent:
        raise ConfigError(f"{name}: has faces of both directions; make its normals agree in a mesh editor")
    if not mesh.volume > 0:
        raise ConfigError(f"{name}: encloses {mesh.volume:g} mm³; turn its faces outwards in a mesh editor")
