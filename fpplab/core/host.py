"""Which program, packages and computer: what logs and bug reports state."""

from __future__ import annotations

import os
import platform
import re
from importlib import metadata
from typing import Any

from fpplab.core.version import __version__


def host_facts() -> dict[str, Any]:
    """Describe program, packages and computer."""
    return {
        "fpplab": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "host": platform.node(),
        "cores": os.cpu_count(),
        "packages": _packages(),
    }


def _packages() -> dict[str, str]:
    """Versions of the packages that fpplab requires; none where it runs without being installed."""
    try:
        required = metadata.requires("fpplab") or []
    except metadata.PackageNotFoundError:
        return {}
    found = {}
    for line in required:
        name = re.split(r"[^\w.-]", line, maxsplit=1)[0]
        if "extra ==" not in line:
            try:
                found[name] = metadata.version(name)
            except metadata.PackageNotFoundError:
                found[name] = "missing"
    return found
