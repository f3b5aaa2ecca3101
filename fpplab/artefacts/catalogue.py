"""Finding artefacts by name: the files of `fpplab.artefacts.shapes`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING

import numpy as np

from fpplab.artefacts import shapes
from fpplab.artefacts.base import Artefact, Lengths
from fpplab.core.errors import ConfigError
from fpplab.core.files import write_atomic

if TYPE_CHECKING:
    import trimesh


def artefact_types() -> dict[str, type[Artefact]]:
    """List the artefacts and standards by name, sorted by `Artefact.order` and then by name."""
    types: dict[str, type[Artefact]] = {}
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
        types[entry.name] = defined[0]
    return dict(sorted(types.items(), key=lambda item: (item[1].order, item[0])))


NAMES = tuple(name for name, shape in artefact_types().items() if not shape.is_standard)


def make(name: str, sizes: Mapping[str, Lengths] | None = None) -> trimesh.Trimesh:
    """Build the mesh of an artefact or standard."""
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
    """Look up the default lengths of an artefact or standard."""
    return asdict(_artefact_type(name)())


def _artefact_type(name: str) -> type[Artefact]:
    types = artefact_types()
    if name not in types:
        raise ConfigError(f"there is no artefact '{name}'; there are {', '.join(types)}")
    return types[name]


def save_stl(mesh: trimesh.Trimesh, path: Path) -> None:
    """Write a mesh as binary STL, atomically: the file is complete or unchanged."""
    import trimesh

    data = trimesh.exchange.stl.export_stl(mesh)
    write_atomic(path, lambda stream: stream.write(data))
