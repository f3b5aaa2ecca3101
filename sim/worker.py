"""Client of the Blender process: start it, request renders, detect its death, end it.

Blender runs in its own process, because bpy is a whole application with global state. Requests go to its
standard input and answers come from its standard output, which are pipes on every system; pictures go through
memory that is gone with both processes, see `sim.picture_memory`.
"""

import os
import pickle
import re
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.errors import ConfigError, DeviceError, DeviceTimeoutError, DisconnectedError
from fpplab.core.extras import need_extra
from fpplab.core.system import BLENDER
from sim.picture_memory import PictureMemory
from sim.scene import RenderScene, RenderSettings, SubpixelView

START_S = 120.0  # longest time that Blender may take to start, in s (chosen)
BEGIN = b"fpplab: answers\n"  # the line before the first answer; what others print before it is passed over
WAIT_S = 0.2  # time in s between which Ctrl-C is heard on Windows (chosen)

_group = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", None)  # Windows has it
OWN_GROUP: dict[str, Any] = {"creationflags": _group} if _group else {"start_new_session": True}
"""How a process is started that does not hear Ctrl-C: this one alone decides what happens."""


class _Answers:
    """Answers of a process, which a thread reads: a wait for them can then end, on every system."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._answers: SimpleQueue[tuple[str, Any] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._read, args=(stream,), daemon=True)
        self._thread.start()

    def _read(self, stream: IO[bytes]) -> None:
        with suppress(EOFError, OSError, ValueError, pickle.UnpicklingError), stream:
            while stream.readline() not in (BEGIN, b""):
                pass
            while True:
                self._answers.put(pickle.load(stream))
        self._answers.put(None)

    def wait(self, timeout_s: float) -> tuple[str, Any]:
        """Return the next answer; `EOFError` after the last, `TimeoutError` where none comes."""
        deadline = time.monotonic() + timeout_s
        while True:
            with suppress(Empty):
                answer = self._answers.get(timeout=WAIT_S)
                if answer is None:
                    raise EOFError
                return answer
            if time.monotonic() > deadline:
                raise TimeoutError

    def close(self) -> None:
        """Wait for the thread, whose stream has come to its end."""
        self._thread.join()


class Blender:
    """One Blender process, started when it is first needed and again after it has died.

    It knows nothing but the scene it was last sent, which is sent again after a restart.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._process: subprocess.Popen[bytes] | None = None
        self._answers: _Answers | None = None
        self._memory: PictureMemory | None = None
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
        self._memory = PictureMemory()
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
        paths = [str(Path(__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", f"{__package__}.blender.server"],
            pass_fds=self._memory.inherited,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            **OWN_GROUP,
        )
        assert self._process.stdout is not None
        self._answers = _Answers(self._process.stdout)
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
        pixels = self._reserve_memory(4 * (count + (textures.size if textures is not None else 0)))
        if textures is not None:
            pixels[count : count + textures.size] = textures.ravel()
        if scene is not self._scene:
            self._send("scene", scene)
            self._scene = scene
        assert self._memory is not None
        self._send(
            "render",
            {
                "place": self._memory.place,
                "textured": textures is not None,
                "views": views,
                "effort": effort,
            },
        )
        self._wait_for_answer("render", timeout_s)
        return pixels[:count].reshape(shape)

    def close(self) -> None:
        """End the process and release all memory; allowed at any time and any number of times."""
        if self._process is not None:
            assert self._process.stdin is not None
            with suppress(OSError):  # what was not read any more
                self._process.stdin.close()  # which ends the process
            try:
                self._process.wait(timeout=5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        for resource in (self._answers, self._memory, self._log):
            if resource is not None:
                resource.close()
        self._process = self._answers = self._memory = self._log = self._scene = None

    def _reserve_memory(self, size: int) -> NDArray[np.float32]:
        assert self._memory is not None
        try:
            return self._memory.grown_to(size)
        except OSError as error:
            raise DeviceError(
                self.name,
                "render",
                f"no {size / 1e6:.0f} MB of memory for the pictures ({error.strerror})",
                "choose a greater binning or fewer sub-pixels in the world file",
            ) from error

    def _send(self, verb: str, content: Any) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        try:
            pickle.dump((verb, content), self._process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
            self._process.stdin.flush()
        except OSError as error:
            raise self._process_ended_error(verb) from error

    def _wait_for_answer(self, doing: str, timeout_s: float) -> None:
        """Wait for the process's answer; anything else, including an interruption, ends the process."""
        assert self._answers is not None
        try:
            verb, content = self._answers.wait(timeout_s)
        except EOFError as error:
            raise self._process_ended_error(doing) from error
        except TimeoutError:
            self._kill()
            raise DeviceTimeoutError(
                self.name, doing, f"Blender did not answer within {timeout_s:.0f} s", "ask for less work"
            ) from None
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
