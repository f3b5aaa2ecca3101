"""Which program, packages and computer: what logs and bug reports state."""

import os
import platform
import re
from functools import cache
from typing import Any

from fpplab.core.version import __version__


def host_facts() -> dict[str, Any]:
    return {
        "fpplab": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "host": platform.node(),
        "cores": os.cpu_count(),
        "packages": {
            name: package_version(name) or "missing"
            for name, extra in extra_by_package().items()
            if not extra
        },
    }


def extra_by_package() -> dict[str, str]:
    """Map each package that fpplab asks for to its extra; empty where it is always needed."""
    from importlib import metadata  # which reads mails: most commands end without

    try:
        lines = metadata.requires("fpplab") or []
    except metadata.PackageNotFoundError:
        return {}
    extras: dict[str, str] = {}
    for line in lines:
        name = re.split(r"[^\w.-]", line, maxsplit=1)[0]
        extra = re.search(r"""extra == ['"]([\w-]+)['"]""", line)
        if name != "fpplab" and not (extra and extra.group(1) == "dev"):
            extras.setdefault(name, extra.group(1) if extra else "")
    return extras


@cache
def package_version(distribution: str) -> str | None:
    from importlib import metadata

    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None
