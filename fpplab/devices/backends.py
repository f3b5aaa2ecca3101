"""Backends of rig files: which modules a rig file may have imported, and the classes in them.

To import a module is to run it, and a rig file may come from a stranger: so it chooses among what is
installed as a backend, and what the user allows.
"""

import importlib
import logging
import os
from difflib import get_close_matches
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from fpplab.core.errors import ConfigError
from fpplab.core.extras import missing_extra
from fpplab.core.plugins import BACKENDS

_log = logging.getLogger(__name__)

IN_WHEELS = {"drivers": "fpplab_drivers", "sim": "fpplab_sim"}
ALLOWED = "FPPLAB_ALLOW_BACKEND"
"""The environment variable that names further modules or packages, with commas between them."""

RENAMED_BACKENDS = {
    "fpplab.operator:Operator": "fpplab.devices.operator:Operator",
    "fpplab.replay:Recording": "fpplab.sessions.replay:RecordedSession",
    "fpplab.replay:ReplayCamera": "fpplab.sessions.replay:ReplayCamera",
    "fpplab.replay:ReplayProjector": "fpplab.sessions.replay:ReplayProjector",
}
"""Backends by the names that early rig files have for them."""


_MEANT = {
    "basler": "pylon pypylon ace usb3 gige",
    "display": "screen monitor hdmi beamer projector window fullscreen",
    "dlp4500": "lightcrafter lightcrafter4500 lcr4500 dlpc350 dlp ti",
    "gentl": "genicam harvesters gigevision usb3vision spinnaker flir ids vimba allied baumer daheng",
    "grbl": "gcode marlin cnc",
    "operator": "manual hand person human",
    "video_camera": "webcam uvc opencv v4l v4l2 usb cv2",
}


@runtime_checkable
class SharedBackend(Protocol):
    """What the devices of a rig share, such as a simulated world, a recording or an emulated wire.

    A rig file names it as `bench`; it is made as `Backend(options)` and handed to every device. `options` is
    the rest of the section, a `dict[str, Any]`; a wrong one is a `ConfigError` on construction.
    """

    def open(self) -> None:
        """Get ready; called once, before any of the devices is opened.

        Raises
        ------
        ConfigError, DeviceError
            It cannot be opened; nothing stays open then.
        """
        ...

    def close(self) -> None:
        """Release everything; called after all devices are closed, whatever failed, any number of times."""
        ...


def allow_backends(names: list[str]) -> None:
    """Allow further modules, or whole packages, in this process and in those that it starts."""
    os.environ[ALLOWED] = ",".join([*filter(None, [os.environ.get(ALLOWED)]), *names])


def load_backend(name: str, rig_file: Path | str, section: str) -> type[Any]:
    where = f"{rig_file}: '{section}.backend' is '{name}'"
    place = _resolve_class_path(name, where)
    module, _, attribute = place.partition(":")
    if module.rpartition(".")[2] == "__main__":
        raise ConfigError(f"{where}: is a program and not a backend")
    if module.endswith(".py"):
        raise ConfigError(
            f"{where}: a module is named without .py: '{module.removesuffix('.py')}:{attribute}'"
        )
    if not _is_allowed(module, place):
        raise ConfigError(f"{where}: {_why_not(module, attribute)}")
    try:
        loaded = importlib.import_module(module)
    except (ImportError, SystemExit) as error:
        if missing := missing_extra(error):
            raise ConfigError(f"{where}: {missing}") from error
        first = module.partition(".")[0]
        unseen = isinstance(error, ModuleNotFoundError) and error.name == first
        advice = f"; add the folder of {first} to PYTHONPATH, or install it" if unseen else ""
        raise ConfigError(f"{where}: cannot be loaded ({error}){advice}") from error
    except Exception as error:  # a module of another author may raise anything when it is imported
        _log.debug("%s: import failed", module, exc_info=error)
        raise ConfigError(f"{where}: cannot be loaded ({type(error).__name__}: {error})") from error
    backend = getattr(loaded, attribute, None)
    if backend is None:
        raise ConfigError(f"{where}: {module} has no {attribute}")
    if not isinstance(backend, type):
        raise ConfigError(f"{where}: not a {section}")
    if lacking := sorted(getattr(backend, "__abstractmethods__", ())):
        raise ConfigError(
            f"{where}: {attribute} lacks {', '.join(lacking)}; each is described in its docstring, "
            f"in fpplab/devices/{section}.py or fpplab/devices/device.py"
        )
    return backend


def _why_not(module: str, attribute: str) -> str:
    announced = [
        entry.value.partition(":")[2] for entry in _announced() if entry.value.startswith(f"{module}:")
    ]
    reason = "is not part of fpplab, and no installed package announces it as a backend"
    if announced:
        reason = f"announces {', '.join(announced)} as a backend, not {attribute}"
    return f"{module} {reason}; if you trust it, add --allow-backend {module}, or set {ALLOWED}={module}"


def _resolve_class_path(name: str, error_prefix: str) -> str:
    if ":" in name:
        return _as_installed(RENAMED_BACKENDS.get(name, name))
    announced = _announced()
    for entry in announced:
        if entry.name == name:
            return entry.value
    names = sorted({entry.name for entry in announced})
    meant = [backend for backend, words in _MEANT.items() if name.lower() in words.split()]
    closest = meant or get_close_matches(name, names, n=1, cutoff=0.6)
    question = f"did you mean {closest[0]}? " if closest else ""
    raise ConfigError(
        f"{error_prefix}: there is no such backend; {question}installed are {', '.join(names) or 'none'}; "
        "any other is named as 'module:Class'"
    )


@cache
def _installed() -> EntryPoints:
    return entry_points(group=BACKENDS)  # reads the records of every package that is installed


def _announced() -> list[EntryPoint]:
    own = tuple(_own_packages())
    return sorted(_installed(), key=lambda entry: not entry.value.startswith(own))


def _own_packages() -> list[str]:
    return ["fpplab", *(new if find_spec(new) else old for old, new in IN_WHEELS.items())]


def _as_installed(class_path: str) -> str:
    """Rename what rig files of a checkout name, where fpplab was installed from a wheel."""
    for old, new in IN_WHEELS.items():
        if class_path.startswith((f"{old}.", f"{old}:")) and find_spec(new):
            return new + class_path.removeprefix(old)
    return class_path


def _is_allowed(module: str, class_path: str) -> bool:
    allowed = (*_own_packages(), *os.environ.get(ALLOWED, "").split(","))
    if any(package and (module == package or module.startswith(f"{package}.")) for package in allowed):
        return True
    return any(entry.value == class_path for entry in _installed())
