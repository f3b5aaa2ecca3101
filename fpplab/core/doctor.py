"""What `fpplab doctor` looks at: packages, system libraries, graphics processors, folders and the disk."""

import os
import platform
import re
import shutil
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from fpplab.core.extras import EXTRAS
from fpplab.core.host import extra_by_package, package_version
from fpplab.core.system import BLENDER, LINUX, USB, cache_directory, missing
from fpplab.core.units import readable_bytes
from fpplab.core.version import __version__

Condition = Literal["ok", "absent", "wrong"]
"""Whether something is as it should be, was left out when fpplab was installed, or has to be corrected."""


@dataclass(frozen=True)
class DoctorLimits:
    """Limits by which folders and disks are judged."""

    trial_bytes: int = 64 << 20  # how much is written to measure the speed of a disk (chosen)
    min_bytes_per_s: float = 50e6  # speed of a disk (derived: 1.2 million pixels 40 times a second)
    min_free_bytes: int = 2 << 30  # free space (chosen: less holds no data set and few scans)


LIMITS = DoctorLimits()

RENDER_NODES, NVIDIA = Path("/dev/dri"), Path("/proc/driver/nvidia/version")
"""Where Linux lists graphics processors that compute, and NVIDIA's driver its version."""


@dataclass(frozen=True)
class DoctorFinding:
    """One thing that was looked at."""

    name: str  # what it is
    state: Condition  # "ok", "absent" or "wrong"
    seen: str  # what was found
    remedy: str = ""  # what to do; empty where nothing has to be done


def installed_versions() -> dict[str, str]:
    versions = {"fpplab": __version__, "python": platform.python_version(), "platform": platform.platform()}
    for name in extra_by_package():
        if version := package_version(name):
            versions[name] = version
    return versions


def check_packages() -> list[DoctorFinding]:
    lacking = [name for name, extra in extra_by_package().items() if not extra and not package_version(name)]
    remedy = "install fpplab again: pip install --force-reinstall fpplab"
    findings = [
        DoctorFinding("packages", "wrong", f"without {', '.join(lacking)}", remedy)
        if lacking
        else DoctorFinding("packages", "ok", "all that recorded scans need")
    ]
    for extra, modules in EXTRAS.items():
        absent = [name for name in modules if find_spec(name) is None]
        findings.append(
            DoctorFinding(extra, "absent", f"without {', '.join(absent)}", f"pip install 'fpplab[{extra}]'")
            if absent
            else DoctorFinding(extra, "ok", "installed")
        )
    return findings


def check_libraries() -> list[DoctorFinding]:
    findings: list[DoctorFinding] = []
    if not LINUX:
        return findings
    for name, module, libraries in (("Blender's libraries", "bpy", BLENDER), ("USB", "usb", USB)):
        if find_spec(module) is not None:
            lacking = missing(libraries)
            findings.append(
                DoctorFinding(
                    *(name, "wrong", f"without {', '.join(lacking)}"),
                    f"sudo apt-get install {' '.join(lacking)}",
                )
                if lacking
                else DoctorFinding(name, "ok", "all are there")
            )
    return findings


def check_folders(folders: Iterable[Path]) -> list[DoctorFinding]:
    findings = []
    for folder in dict.fromkeys(path.absolute() for path in (*folders, cache_directory())):
        place = next(path for path in (folder, *folder.parents) if path.exists())
        free = shutil.disk_usage(place).free
        observed = f"{readable_bytes(free)} are free"
        if not os.access(place, os.W_OK | os.X_OK):
            findings.append(DoctorFinding(str(folder), "wrong", "cannot be written", "choose another folder"))
        elif free < LIMITS.min_free_bytes:
            findings.append(
                DoctorFinding(str(folder), "wrong", observed, "free some space, or use another disk")
            )
        else:
            findings.append(DoctorFinding(str(folder), "ok", observed))
    return findings


def check_graphics(nodes: Path = RENDER_NODES, nvidia: Path = NVIDIA) -> DoctorFinding:
    devices = sorted(nodes.glob("renderD*"))
    closed = [str(device) for device in devices if not os.access(device, os.R_OK | os.W_OK)]
    names = [str(device) for device in devices]
    if nvidia.is_file():
        version = re.search(r"Kernel Module\s+(?:for \S+\s+)?([\d.]+)", nvidia.read_text(encoding="utf-8"))
        names.append(f"NVIDIA's driver {version.group(1) if version else 'of unknown version'}")
    if closed:
        remedy = "add yourself to its group (sudo usermod -aG render $USER), and log in again"
        return DoctorFinding("graphics", "wrong", f"this user may not open {', '.join(closed)}", remedy)
    if not names:
        return DoctorFinding("graphics", "absent", "none; Blender renders on the processor, which is enough")
    return DoctorFinding("graphics", "ok", ", ".join(names))


def check_disk(folder: Path, size: int = LIMITS.trial_bytes) -> DoctorFinding:
    block = os.urandom(1 << 20)
    try:
        with tempfile.TemporaryFile(dir=folder) as stream:
            start = time.perf_counter()
            for _ in range(max(1, size >> 20)):
                stream.write(block)
            stream.flush()
            os.fsync(stream.fileno())
            speed = stream.tell() / (time.perf_counter() - start)
    except OSError as error:
        observed = f"{folder}: cannot be written ({error.strerror})"
        return DoctorFinding("disk", "wrong", observed, "free some space")
    return disk_speed_finding(folder, speed)


def disk_speed_finding(folder: Path, speed: float) -> DoctorFinding:
    observed = f"{folder.absolute()}: {speed / 1e6:.0f} MB/s written"
    if speed < LIMITS.min_bytes_per_s:
        return DoctorFinding("disk", "wrong", observed, "measure onto a faster disk, or frames may be lost")
    return DoctorFinding("disk", "ok", observed)
