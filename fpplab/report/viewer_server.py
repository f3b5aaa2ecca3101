"""The process of the viewer: rerun's own program, which shows a window or serves a page."""

from __future__ import annotations

import atexit
import importlib.util
import os
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Literal

from fpplab.core.errors import DeviceError

LOCAL = "127.0.0.1"
PATIENCE_S = 20.0
"""Longest time in s that the viewer may take to start."""
MEMORY = "1GB"
"""Memory limit of the server."""


class ViewerServer:
    """The process of rerun, reachable from this computer only.

    Parameters
    ----------
    kind : {"window", "browser"}
        Whether it shows a window or serves a page.

    Attributes
    ----------
    data : str
        Address to which a recording is sent.
    page : str
        Address that the operator opens; "window" for a window.

    Raises
    ------
    DeviceError
        The program is not installed, or does not start.
    """

    def __init__(self, kind: Literal["window", "browser"]) -> None:
        data, web = _free_ports(2)
        self.data = f"rerun+http://{LOCAL}:{data}/proxy"
        self._home = tempfile.TemporaryDirectory(prefix="fpplab-viewer-", ignore_cleanup_errors=True)
        command = [_program(), "--bind", LOCAL, "--port", str(data), "--hide-welcome-screen"]
        if kind == "browser":
            self.page = f"http://{LOCAL}:{web}/?url=rerun%2Bhttp://{LOCAL}:{data}/proxy&hide_welcome_screen=1"
            command += ["--serve-web", "--web-viewer-port", str(web), "--server-memory-limit", MEMORY]
        else:
            self.page = "window"
            command += ["--expect-data-soon"]
        environment = self._private()
        self._log = Path(self._home.name) / "log"
        with self._log.open("wb") as stream:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=stream, stderr=stream, env=environment
            )
        atexit.register(self.stop)
        try:
            for port in (data, web) if kind == "browser" else (data,):
                self._await(port)
        except BaseException:
            self.stop()
            raise

    def _private(self) -> dict[str, str]:
        """Make an environment in which rerun sends no usage statistics."""
        environment = {**os.environ, "XDG_CONFIG_HOME": self._home.name, "RUST_LOG": "warn"}
        subprocess.run(
            [_program(), "analytics", "disable"],
            env=environment,
            timeout=PATIENCE_S,
            check=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        return environment

    @property
    def pid(self) -> int:
        """Identifier of the process."""
        return self._process.pid

    @property
    def runs(self) -> bool:
        """Whether the process is running: an operator may have closed the window."""
        return self._process.poll() is None

    def wait(self) -> None:
        """Wait until the process has ended."""
        self._process.wait()

    def stop(self) -> None:
        """End the process and delete its files; may be called any number of times."""
        atexit.unregister(self.stop)
        if self.runs:
            self._process.terminate()
            try:
                self._process.wait(5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._home.cleanup()

    def _await(self, port: int) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            if not self.runs:
                words = self._log.read_text(errors="replace").strip().splitlines()
                raise DeviceError(
                    "viewer", "open", f"rerun ended: {words[-1] if words else 'no reason given'}"
                )
            with suppress(OSError), socket.create_connection((LOCAL, port), 1.0):
                return
            time.sleep(0.05)
        raise DeviceError("viewer", "open", f"rerun did not start within {PATIENCE_S:g} s")


def _program() -> str:
    """Find the program itself, not the script around it, which would not end the program with it."""
    found = importlib.util.find_spec("rerun_cli")
    if found is None or found.origin is None:
        raise DeviceError("viewer", "open", "rerun-sdk is not installed", "install fpplab again")
    return str(Path(found.origin).parent / ("rerun.exe" if sys.platform == "win32" else "rerun"))


def _free_ports(n: int) -> list[int]:
    sockets = [socket.create_server((LOCAL, 0)) for _ in range(n)]
    ports = [int(s.getsockname()[1]) for s in sockets]
    for s in sockets:
        s.close()
    return ports
