"""Client of the Blender process: start it, request renders, detect its death, end it.

Blender runs in its own process, because bpy is a whole application with global state. Requests go over a
socket, pictures through anonymous shared memory: it has no name, so nothing can be left behind, whichever
process is killed, and it does not depend on the size of /dev/shm.
"""

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

from fpplab.core.errors import ConfigError, DeviceError, DeviceTimeoutError, DisconnectedError
from fpplab.core.extras import need_extra
from fpplab.core.system import BLENDER
from sim.scene import RenderScene, RenderSettings, SubpixelView

START_S = 120.0  # longest time that Blender may take to start, in s (chosen)


class Blender:
    """One Blender process, started when it is first needed and again after it has died.

    It knows nothing but the scene it was last sent, which is sent again after a restart.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._memory = -1
        self._pixels = np.empty(0, np.float32)
        self._log: IO[bytes] | None = None
        self._scene: RenderScene | None = None

    @property
    def pid(self) -> int | None:
        return self._process.pid if self._process and self._process.poll() is None else None

    def start(self) -> None:
        if self.pid is not None:
            return
        need_extra("bpy")
        self.close()
        ours, theirs = socket.socketpair()
        try:
            self._memory = os.memfd_create("fpplab-pictures")
            self._log = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    "-P",
                    "-m",
                    f"{__package__}.blender.server",
                    str(theirs.fileno()),
                    str(self._memory),
                ],
                pass_fds=(theirs.fileno(), self._memory),
                stdin=subprocess.DEVNULL,
                stdout=self._log,
                stderr=self._log,
                start_new_session=True,  # Ctrl-C reaches this process alone, which decides what happens
                env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
            )
            self._connection = Connection(ours.detach())
        finally:
            ours.close()
            theirs.close()
        self._wait_for_answer("start", START_S)

    def render(
        self,
        scene: RenderScene,
        textures: NDArray[np.float32] | None,
        views: list[SubpixelView],
        effort: RenderSettings,
        timeout_s: float,
    ) -> NDArray[np.float32]:
        # textures (circles, rows, columns, 3)
        self.start()
        width, height = scene.camera.size
        shape = (len(views), height, width, effort.channels)
        count = int(np.prod(shape))
        pixels = self._reserve_shared_memory(4 * (count + (textures.size if textures is not None else 0)))
        if textures is not None:
            pixels[count : count + textures.size] = textures.ravel()
        if scene is not self._scene:
            self._send("scene", scene)
            self._scene = scene
        self._send("render", {"textured": textures is not None, "views": views, "effort": effort})
        self._wait_for_answer("render", timeout_s)
        return pixels[:count].reshape(shape)

    def close(self) -> None:
        """End the process and release all memory; allowed at any time and any number of times."""
        if self._connection is not None:
            self._connection.close()  # which ends the process
        if self._process is not None:
            try:
                self._process.wait(timeout=5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        if self._memory >= 0:
            os.close(self._memory)
        if self._log is not None:
            self._log.close()
        self._process = self._connection = self._log = self._scene = None
        self._memory, self._pixels = -1, np.empty(0, np.float32)

    def _reserve_shared_memory(self, size: int) -> NDArray[np.float32]:
        """Map the shared memory, grown to at least `size` bytes."""
        if size <= self._pixels.nbytes:
            return self._pixels
        try:
            os.posix_fallocate(self._memory, 0, size)
        except OSError as error:
            raise DeviceError(
                self.name,
                "render",
                f"no {size / 1e6:.0f} MB of memory for the pictures ({error.strerror})",
                "choose a greater binning or fewer sub-pixels in the world file",
            ) from error
        self._pixels = np.frombuffer(mmap.mmap(self._memory, size), np.float32)
        return self._pixels

    def _send(self, verb: str, content: Any) -> None:
        assert self._connection is not None
        try:
            self._connection.send((verb, content))
        except OSError as error:
            raise self._process_ended_error(verb) from error

    def _wait_for_answer(self, doing: str, timeout_s: float) -> None:
        """Wait for the process's answer; anything else, including an interruption, ends the process."""
        assert self._connection is not None
        try:
            if not self._connection.poll(timeout_s):
                raise DeviceTimeoutError(
                    self.name, doing, f"Blender did not answer within {timeout_s:.0f} s", "ask for less work"
                )
            verb, content = self._connection.recv()
        except (EOFError, OSError) as error:
            raise self._process_ended_error(doing) from error
        except BaseException:
            self._kill()
            raise
        if verb == "refused":
            raise ConfigError(f"world: {content}")
        if verb == "failed":
            raise DeviceError(self.name, doing, f"Blender failed: {content}", "see the world file")

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()
        self.close()

    def _process_ended_error(self, doing: str) -> DeviceError:
        """Make the error for a process that is gone, with its last line of output."""
        output = ""
        if self._process is not None and self._log is not None:
            self._process.kill()
            self._process.wait()
            self._log.seek(0)
            output = self._log.read().decode(errors="replace").strip()
        self.close()
        missing = missing_library(output)
        if missing:
            return DeviceError(self.name, doing, *missing)
        last = output.splitlines()[-1] if output else "no output"
        return DisconnectedError(
            self.name, doing, f"the Blender process has died ({last})", "run the same command again"
        )


def missing_library(output: str) -> tuple[str, str] | None:
    """Recognise a missing system library in Blender's output."""
    # returns (str, str)
    match = re.search(r"(lib[\w.+-]*\.so[.\d]*): cannot open shared object file", output)
    if match is None:
        return None
    library = match.group(1)
    package = BLENDER.get(library)
    remedy = f"run: apt-get install {package}" if package else f"install the package that has {library}"
    return f"Blender needs the system library {library}, which is missing", remedy
