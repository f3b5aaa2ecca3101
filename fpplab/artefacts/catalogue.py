"""Finding artefacts by name: the files of `fpplab.artefacts.shapes`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from fpplab.artefacts import shapes
from fpplab.artefacts.base import Artefact, Lengths
from fpplab.core.errors import ConfigError
from fpplab.core.files import write_atomic
from fpplab.core.geometry import RigidTransform

if TYPE_CHECKING:
    import trimesh


def artefact_types() -> dict[str, type[Artefact]]:
    """List the artefacts and standards by name, sorted by `Artefact.order` and then by name.

    Returns
    -------
    dict of str to type of Artefact
        The class that each file of `fpplab.artefacts.shapes` defines, by the file's name.

    Raises
    ------
    TypeError
        A file does not define exactly one subclass of `Artefact`.
    """
    found: dict[str, type[Artefact]] = {}
    for entry in iter_modules(shapes.__path__):
        module = import_module(f"{shapes.__name__}.{entry.name}")
        defined = [
            value
            for value in vars(module).values()
            if isinstance(value, type) and issubclass(value, Artefact) and value.__module__ == module.__name__
        ]
        if len(defined) != 1:
            raise TypeError(
                f"{module.__name__} must define exactly one subclass of Artefact, not {len(defined)}"
            )
        found[entry.name] = defined[0]
    return dict(sorted(found.items(), key=lambda item: (item[1].order, item[0])))


NAMES = tuple(name for name, shape in artefact_types().items() if not shape.is_standard)
"""Names of the artefacts, which measured clouds are compared with."""

SAME_MM = 1e-3
"""Deviation of corners up to which a mesh is that of an artefact; files have 32 bit floats."""

STANDARDS = tuple(name for name, shape in artefact_types().items() if shape.is_standard)
"""Names of the standards, which an acceptance test measures."""


def make(name: str, sizes: Mapping[str, Lengths] | None = None) -> trimesh.Trimesh:
    """Build the mesh of an artefact or standard.

    Parameters
    ----------
    name : str
        One of `NAMES` or `STANDARDS`.
    sizes : Mapping of str to Lengths, optional
        Lengths in mm by field that differ from the usual ones (`usual_sizes`).

    Returns
    -------
    trimesh.Trimesh
        A single watertight body with outward normals, in mm: base on z = 0, z up, centred on x = y = 0.

    Raises
    ------
    ConfigError
        There is no artefact of that name (the message lists the names), no such length, not as many lengths
        as the field has, or lengths that do not give a solid.
    """
    usual = usual_sizes(name)
    for field, value in (sizes or {}).items():
        if field not in usual:
            raise ConfigError(f"'{name}' has no length '{field}'; it has {', '.join(usual)}")
        if np.shape(value) != np.shape(usual[field]):
            raise ConfigError(
                f"'{name}' needs for '{field}' as many lengths as in {usual[field]}, not {value}"
            )
    return _artefact_type(name)(**(sizes or {})).mesh()


def usual_sizes(name: str) -> dict[str, Lengths]:
    """Look up the default lengths of an artefact or standard.

    Parameters
    ----------
    name : str
        One of `NAMES` or `STANDARDS`.

    Returns
    -------
    dict of str to Lengths
        Lengths in mm by field.

    Raises
    ------
    ConfigError
        There is no artefact of that name; the message lists the names.
    """
    return asdict(_artefact_type(name)())


@dataclass(frozen=True, eq=False)
class PlacedArtefact:
    """An artefact, and where it is in the frame of a mesh.

    Attributes
    ----------
    artefact : Artefact
        With its lengths.
    pose : RigidTransform
        T_mesh_artefact, in mm.
    """

    artefact: Artefact
    pose: RigidTransform


def recognise(mesh: trimesh.Trimesh) -> PlacedArtefact | None:
    """Recognise an artefact or standard of usual size by its mesh, wherever that is placed.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        In mm, as `make` gives it or read from a file that `save_stl` wrote, moved by any rigid motion.

    Returns
    -------
    PlacedArtefact or None
        None for any other mesh, such as that of a printed shape.
    """
    for shape in artefact_types().values():
        known = shape()
        drawn = np.asarray(known.mesh().triangles, np.float64).reshape(-1, 3)
        seen = np.asarray(mesh.triangles, np.float64).reshape(-1, 3)
        if len(drawn) != len(seen):
            continue
        turn, _ = Rotation.align_vectors(seen - seen.mean(axis=0), drawn - drawn.mean(axis=0))
        rotation = turn.as_matrix()
        pose = RigidTransform(rotation, seen.mean(axis=0) - rotation @ drawn.mean(axis=0))
        if np.abs(pose.apply(drawn) - seen).max() <= SAME_MM:
            return PlacedArtefact(known, pose)
    return None


def _artefact_type(name: str) -> type[Artefact]:
    known = artefact_types()
    if name not in known:
        raise ConfigError(f"there is no artefact '{name}'; there are {', '.join(known)}")
    return known[name]


def save_stl(mesh: trimesh.Trimesh, path: Path) -> None:
    """Write a mesh as binary STL, atomically: the file is complete or unchanged.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Corners in mm.
    path : Path
        Where to write.

    Raises
    ------
    DataError
        The file cannot be written.
    """
    import trimesh

    data = trimesh.exchange.stl.export_stl(mesh)
    write_atomic(path, lambda stream: stream.write(data))
