"""Reading the user's own parts from mesh files, with checks that each is one usable solid."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fpplab.core.errors import ConfigError, DataError

if TYPE_CHECKING:
    import trimesh


def load_part(path: Path) -> trimesh.Trimesh:
    """Read a part from an STL, PLY or OBJ file."""
    # Corners that coincide are joined; colours and texture are ignored.
    from fpplab.clouds import load_mesh  # half a second that making artefacts does not need

    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file; check the path")
    try:
        mesh = load_mesh(path)
    except DataError as error:
        raise ConfigError(str(error)) from error
    check_solid(mesh, str(path))
    largest = float(mesh.extents.max())
    if largest < 1.0:  # chosen: no part this small is measured
        raise ConfigError(f"{path}: looks like metres, for it is {largest:g} mm large; scale by 1000")
    return mesh


def count_unpaired_edges(mesh: trimesh.Trimesh) -> int:
    _, joins = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    return int((joins != 2).sum())


def check_solid(mesh: trimesh.Trimesh, name: str) -> None:
    """Check that a mesh is closed and its faces are directed outwards."""
    if len(mesh.faces) == 0:
        raise ConfigError(f"{name}: has no faces; give the mesh of a solid")
    if unpaired := count_unpaired_edges(mesh):
        raise ConfigError(
            f"{name}: is not watertight, for {unpaired} open edges do not join two faces; "
            "close its surface in a mesh editor"
        )
    if not mesh.is_winding_consistent:
        raise ConfigError(f"{name}: has faces of both directions; make its normals agree in a mesh editor")
    if not mesh.volume > 0:
        raise ConfigError(f"{name}: encloses {mesh.volume:g} mm³; turn its faces outwards in a mesh editor")
