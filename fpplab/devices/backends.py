"""Backends of rig files: which modules a rig file may have imported, and the classes in them.

To import a module is to run it. A rig file may come from a stranger, so it chooses among what was installed
as a backend: fpplab's own modules, what an installed package announces as such, and what the user allows.
"""

from __future__ import annotations

import importlib
import os
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from fpplab.core.errors import ConfigError
from fpplab.core.plugins import BACKENDS

OWN_PACKAGES = ("fpplab", "drivers", "sim")
"""Packages whose modules are always allowed."""
ALLOWED = "FPPLAB_ALLOW_BACKEND"
"""The environment variable that names further modules or packages, with commas between them."""

RENAMED_BACKENDS = {
    "fpplab.operator:Operator": "fpplab.devices.operator:Operator",
    "fpplab.replay:Recording": "fpplab.sessions.replay:RecordedSession",
    "fpplab.replay:ReplayCamera": "fpplab.sessions.replay:ReplayCamera",
    "fpplab.replay:ReplayProjector": "fpplab.sessions.replay:ReplayProjector",
}
"""Backends by the names that rig files of version 0.1.0 have for them."""


def allow_backends(names: list[str]) -> None:
    """Allow further modules in this process, and in those that it starts.

    Parameters
    ----------
    names : list of str
        Modules, or packages with all that is in them.
    """
    os.environ[ALLOWED] = ",".join([*filter(None, [os.environ.get(ALLOWED)]), *names])


def load_backend(name: str, source: Path | str, device: str) -> type[Any]:
    """Import a backend of a rig file.

    Parameters
    ----------
    name : str
        `module:Class`, as the rig file has it.
    source : path or str
        What the rig file is called in messages.
    device : str
        The section of the rig file, for messages.

    Returns
    -------
    type
        The class.

    Raises
    ------
    ConfigError
        The module is not allowed, cannot be imported, or has no such class.
    """
    name, named = RENAMED_BACKENDS.get(name, name), name
    module, _, attribute = name.partition(":")
    where = f"{source}: '{device}.backend' is '{named}'"
    if module.rpartition(".")[2] == "__main__":
        raise ConfigError(f"{where}: is a program and not a backend")
    if not _is_allowed(module, name):
        raise ConfigError(
            f"{where}: {module} is not part of fpplab, and no installed package announces it as a backend; "
            f"if you trust it, add --allow-backend {module}, or set {ALLOWED}={module}"
        )
    try:
        backend = getattr(importlib.import_module(module), attribute)
    except (ImportError, SystemExit) as error:
        raise ConfigError(f"{where}: cannot be loaded ({error})") from error
    except AttributeError:
        raise ConfigError(f"{where}: {module} has no {attribute}") from None
    if not isinstance(backend, type):
        raise ConfigError(f"{where}: not a {device}")
    return backend


def _is_allowed(module: str, name: str) -> bool:
    allowed = (*OWN_PACKAGES, *os.environ.get(ALLOWED, "").split(","))
    if any(one and (module == one or module.startswith(f"{one}.")) for one in allowed):
        return True
    return any(entry.value == name for entry in entry_points(group=BACKENDS))
