"""The Blender process seen from outside: start it, have it render, notice its death, end it.

Blender runs in its own process, because bpy is a whole application with global state. Requests go over a
socket, pictures through anonymous shared memory: it has no name, so nothing can be left behind, whichever
process is killed, and it does not depend on the size of /dev/shm.
"""

from __future__ import annotations

import mmap
import os
import re
import socket
import subprocess
import sys
import tempfile
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from fpplab.errors import DeviceError, DisconnectedError, TimeoutError
from fpplab.system import BLENDER
from sim.scene import CHANNELS, Effort, Scene

START_S = 120.0
STOP_S = 5.0


class Blender:
    """One Blender process, started when it is first needed and again after it has died.

    It knows nothing but the scene it was last sent, which is sent again after a restart.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._memory = -1
        self._capacity = 0
        self._log: IO[bytes] | None = None
        self._scene: Scene | None = None

    @property
    def pid(self) -> int | None:
        """The process's id, or None when there is none."""
        return self._process.pid if self._process and self._process.poll() is None else None

    def start(self) -> None:
        """Start it unless it runs. Raises `DeviceError` that says what is missing, `TimeoutError`."""
        if self.pid is not None:
            return
        self.close()
        ours, theirs = socket.socketpair()
        try:
            self._memory, self._capacity = _anonymous_memory(), 0
            self._log = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "sim.blender.server", str(theirs.fileno()), str(self._memory)],
                pass_fds=(theirs.fileno(), self._memory),
                stdin=subprocess.DEVNULL,
                stdout=self._log,
                stderr=self._log,
                start_new_session=True,  # what an interruption means is decided here
                env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
            )
            self._connection = Connection(ours.detach())
        finally:
            ours.close()
            theirs.close()
        self._answer("start", START_S)

    def render(
        self,
        scene: Scene,
        texture: NDArray[np.float32] | None,
        shifts: list[tuple[float, float]],
        effort: Effort,
        timeout_s: float,
    ) -> NDArray[np.float32]:
        """Render `scene` under `texture` (rows, columns, 3), once for every shift of the pixels' centres.

        Without a texture the projector paints its own coordinates (column, row, 1). Returns (shifts, height,
        width, CHANNELS) float32: radiance relative to white in three colours, and reflectance.
        Raises `DisconnectedError` when the process dies, `TimeoutError`, `DeviceError` when Blender fails.
        """
        self.start()
        width, height = scene.camera.size
        shape = (len(shifts), height, width, CHANNELS)
        count = int(np.prod(shape))
        self._reserve(4 * (count + (texture.size if texture is not None else 0)))
        pixels = np.frombuffer(mmap.mmap(self._memory, self._capacity), np.float32)
        if texture is not None:
            pixels[count : count + texture.size] = texture.ravel()
        if scene is not self._scene:
            self._send("scene", scene)
            self._scene = scene
        self._send("render", {"textured": texture is not None, "shifts": shifts, "effort": effort})
        self._answer("render", timeout_s)
        return pixels[:count].reshape(shape).copy()

    def close(self) -> None:
        """End the process and let go of everything; legal at any time, any number of times."""
        if self._connection is not None:
            self._connection.close()  # which ends the process
        if self._process is not None:
            try:
                self._process.wait(STOP_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        if self._memory >= 0:
            os.close(self._memory)
        if self._log is not None:
            self._log.close()
        self._process = self._connection = self._log = self._scene = None
        self._memory = -1

    def _reserve(self, size: int) -> None:
        if size <= self._capacity:
            return
        try:
            os.posix_fallocate(self._memory, 0, size)
        except OSError as error:
            raise DeviceError(
                self.name,
                "render",
                f"no {size / 1e6:.0f} MB of memory for the pictures ({error.strerror})",
                "choose a greater binning or fewer sub-pixels in the world file",
            ) from error
        self._capacity = size

    def _send(self, verb: str, content: Any) -> None:
        assert self._connection is not None
        try:
            self._connection.send((verb, content))
        except OSError as error:
            raise self._dead(verb) from error

    def _answer(self, doing: str, timeout_s: float) -> None:
        """Wait for the process; anything but its answer, an interruption too, ends it."""
        assert self._connection is not None
        try:
            if not self._connection.poll(timeout_s):
                raise TimeoutError(
                    self.name, doing, f"Blender did not answer within {timeout_s:.0f} s", "ask for less work"
                )
            verb, content = self._connection.recv()
        except (EOFError, OSError) as error:
            raise self._dead(doing) from error
        except BaseException:
            self._kill()
            raise
        if verb == "failed":
            raise DeviceError(self.name, doing, f"Blender failed: {content}", "see the world file")

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()
        self.close()

    def _dead(self, doing: str) -> DeviceError:
        """The error for a process that is gone, with what it said last."""
        said = ""
        if self._process is not None and self._log is not None:
            self._process.kill()
            self._process.wait()
            self._log.seek(0)
            said = self._log.read().decode(errors="replace").strip()
        self.close()
        missing = missing_library(said)
        if missing:
            return DeviceError(self.name, doing, *missing)
        last = said.splitlines()[-1] if said else "it said nothing"
        return DisconnectedError(
            self.name, doing, f"the Blender process has died ({last})", "run the same command again"
        )


def missing_library(said: str) -> tuple[str, str] | None:
    """(found, remedy) when Blender's output tells of a missing system library, else None."""
    match = re.search(r"(lib[\w.+-]*\.so[.\d]*): cannot open shared object file", said)
    if match is None:
        return None
    library = match.group(1)
    package = BLENDER.get(library)
    remedy = f"run: apt-get install {package}" if package else f"install the package that has {library}"
    return f"Blender needs the system library {library}, which is missing", remedy


def _anonymous_memory() -> int:
    """A descriptor of growing memory without a name."""
    return os.memfd_create("fpplab-pictures")
