"""What differs between systems: modules, and libraries that Python packages need and pip cannot install.

Run as a program it names the libraries that are missing.
"""

import ctypes
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

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

USB = {"libusb-1.0.so.0": "libusb-1.0-0"}  # debian packages of the libraries that pyusb and hidapi use
LINUX = sys.platform.startswith("linux")
"""Whether packages need libraries of the system; on Windows and macOS they bring their own."""


posix: Any = os
"""`os` for what Windows lacks of it."""


def system_module(name: str) -> Any:
    """Import a module that not every system has; None where it is missing."""
    try:
        return import_module(name)
    except ImportError:
        return None


WINDOWS = system_module("msvcrt") is not None


def cache_directory() -> Path:
    chosen = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return Path(chosen or Path.home() / ".cache") / "fpplab"


def missing(libraries: dict[str, str]) -> list[str]:
    return [package for name, package in libraries.items() if LINUX and not _loads(name)]


def _loads(name: str) -> bool:
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True


def main() -> int:
    """Report everything that is missing; without the USB libraries the simulation still runs."""
    blender, usb = missing(BLENDER), missing(USB)
    if usb:
        sys.stderr.write(
            "fpplab: a real projector needs a system library that is missing (the virtual bench does not); "
            f"install it with: sudo apt-get install {' '.join(usb)}\n"
        )
    if blender:
        sys.stderr.write(
            "fpplab: Blender needs system libraries that are missing; install them with: "
            f"sudo apt-get install {' '.join(blender)}\n"
        )
    return 1 if blender else 0


if __name__ == "__main__":
    sys.exit(main())
