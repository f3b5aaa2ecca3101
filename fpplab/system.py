"""The system libraries that the Python packages need and pip cannot bring.

`python -m fpplab.system` names each one that is missing, with the Debian package to install.
"""

from __future__ import annotations

import ctypes
import sys

from fpplab.errors import ConfigError

BLENDER = {
    "libX11.so.6": "libx11-6",
    "libSM.so.6": "libsm6",
    "libICE.so.6": "libice6",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libXrender.so.1": "libxrender1",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libGL.so.1": "libgl1",
}
"""What Blender's module links to, by Debian package."""

USB = {"libusb-1.0.so.0": "libusb-1.0-0"}
"""What pyusb and hidapi talk through."""


def missing(libraries: dict[str, str]) -> list[str]:
    """The packages of those libraries that do not load."""
    return [package for name, package in libraries.items() if not _loads(name)]


def require(libraries: dict[str, str], purpose: str) -> None:
    """Refuse in one sentence, naming the packages to install: `ConfigError`."""
    if packages := missing(libraries):
        raise ConfigError(
            f"{purpose} needs system libraries that are missing; install them with: "
            f"sudo apt-get install {' '.join(packages)}"
        )


def _loads(name: str) -> bool:
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True


def main() -> int:
    """Tell of everything missing; a set-up without USB can still run the virtual bench."""
    if packages := missing({**BLENDER, **USB}):
        sys.stderr.write(
            "fpplab: system libraries are missing; install them with: "
            f"sudo apt-get install {' '.join(packages)}\n"
        )
    return 1 if missing(BLENDER) else 0


if __name__ == "__main__":
    sys.exit(main())
