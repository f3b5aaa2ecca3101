"""The server of the viewer: rerun's program in a window, or a page, on this computer alone."""

import atexit
import importlib.util
import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from fpplab.core.errors import DeviceError
from fpplab.core.extras import MissingExtraError
from fpplab.viewer import host

ServerKind = Literal["window", "browser"]
"""A window on this display, or a page for a browser on this computer."""
ViewerPlace = Literal["window", "browser", "anywhere"]
"""A window, a page, or a window where there is a display and one can be opened, and a page otherwise."""
PROCESS_GROUP = 0 if os.name == "posix" else None
"""A new process group, so that Ctrl-C is for the command alone. In a session of its own, Linux would give it
a share of the processor whatever its niceness."""


class ViewerServer:
    """The process that serves the viewer, to who has its address; it ends with the one that started it."""

    def __init__(self, kind: ServerKind, file: Path | None = None) -> None:
        shown = str(file.absolute()) if file else ""
        command = [sys.executable, "-I", host.__file__, _find_rerun_program(), kind, shown]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, process_group=PROCESS_GROUP
        )
        atexit.register(self.stop)
        where = self._next_report()
        if "page" not in where:
            self.stop()
            raise DeviceError("viewer", "open", where.get("fault", "its process ended"))
        self.page = str(where["page"])

    def send(self, recording: bytes) -> None:
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.write(recording)
            self._process.stdin.flush()

    @property
    def runs(self) -> bool:
        return self._process.poll() is None

    def wait(self) -> None:
        while report := self._next_report():
            if "closed" in report:
                return

    def stop(self) -> None:
        """End the process and delete its files; may be called any number of times."""
        atexit.unregister(self.stop)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(OSError):
            self._process.stdin.close()
        try:
            self._process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()

    def _next_report(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        with suppress(OSError, ValueError):  # `stop` has closed it in another thread
            line = self._process.stdout.readline()
            return dict(json.loads(line)) if line else {}
        return {}


def open_server(shown: ViewerPlace, file: Path | None = None) -> ViewerServer:
    if shown != "anywhere":
        return ViewerServer(shown, file)
    if has_display():
        with suppress(DeviceError):
            return ViewerServer("window", file)
    return ViewerServer("browser", file)


def has_display() -> bool:
    if sys.platform.startswith("linux"):
        return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return True


def _find_rerun_program() -> str:
    """Find the program itself, not the script around it, which would not end the program with it."""
    spec = importlib.util.find_spec("rerun_cli")
    if spec is None or spec.origin is None:
        raise MissingExtraError("rerun_cli")
    return str(Path(spec.origin).parent / ("rerun.exe" if sys.platform == "win32" else "rerun"))
