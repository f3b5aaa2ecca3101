"""The Blender process: takes scenes and render requests from `sim.worker`, leaves pictures in shared memory.

Started as `python -m sim.blender.server SOCKET MEMORY` with two inherited file descriptors. It ends when the
socket does, whatever it is doing, so that it never outlives the process that started it.
"""

from __future__ import annotations

import mmap
import os
import select
import sys
import threading
import warnings
from multiprocessing.connection import Connection

import bpy
import numpy as np

from sim.blender.scene import Studio
from sim.scene import CHANNELS, Effort, Scene


def serve(connection: Connection, memory: int) -> None:
    """Answer requests until the other end is gone."""
    studio, scene = Studio(), None
    connection.send(("ready", bpy.app.version_string))
    while True:
        verb, content = connection.recv()
        try:
            if verb == "scene":
                scene = content
                continue
            _render(studio, scene, memory, **content)
            connection.send(("done", None))
        except Exception as error:  # noqa: BLE001 - reported to the process that asked
            connection.send(("failed", f"{type(error).__name__}: {error}"))


def _render(
    studio: Studio,
    scene: Scene | None,
    memory: int,
    textured: bool,
    shifts: list[tuple[float, float]],
    effort: Effort,
) -> None:
    if scene is None:
        raise RuntimeError("there is no scene yet")
    width, height = scene.camera.size
    pixels = np.frombuffer(mmap.mmap(memory, 0), np.float32)
    shape = (len(shifts), height, width, CHANNELS)
    count = int(np.prod(shape))
    texture = None
    if textured:
        rows, columns = scene.lamp.texture_shape
        texture = pixels[count : count + rows * columns * 3].reshape(rows, columns, 3)
    studio.render(scene, texture, shifts, effort, pixels[:count].reshape(shape))


def _end_with(socket: int) -> None:
    """End at once when the other end of the socket is gone, even in the middle of a render."""
    watch = select.poll()
    watch.register(socket, 0)

    def wait() -> None:
        watch.poll()
        os._exit(0)

    threading.Thread(target=wait, daemon=True).start()


def main(arguments: list[str]) -> None:
    """Serve on the inherited socket and memory named by their descriptors."""
    socket, memory = map(int, arguments)
    warnings.simplefilter("ignore", DeprecationWarning)
    _end_with(socket)
    try:
        serve(Connection(socket), memory)
    except (EOFError, OSError):
        os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1:])
