"""The Blender process: answers the requests of `sim.worker` and writes pictures to shared memory.

Started as `python -m sim.blender.server SOCKET MEMORY` with two inherited file descriptors. It ends when the
socket is closed, whatever it is doing, so that it never outlives the process that started it.
"""

import mmap
import os
import select
import sys
import threading
import warnings
from multiprocessing.connection import Connection

import bpy
import numpy as np
from numpy.typing import NDArray

from sim.blender.scene import BlenderScene
from sim.scene import RenderRefused, RenderScene, RenderSettings, SubpixelView


def serve_renders(connection: Connection, memory: int) -> None:
    """Answer requests until the other end is closed."""
    renderer, scene, pixels = BlenderScene(), None, np.empty(0, np.float32)
    connection.send(("ready", bpy.app.version_string))
    while True:
        verb, content = connection.recv()
        try:
            if verb == "scene":
                scene = content
                continue
            if os.fstat(memory).st_size > pixels.nbytes:
                pixels = np.frombuffer(mmap.mmap(memory, 0), np.float32)
            _render_views(renderer, scene, pixels, **content)
            connection.send(("done", None))
        except RenderRefused as refused:
            connection.send(("refused", str(refused)))
        except Exception as error:  # noqa: BLE001 - reported to the process that asked
            connection.send(("failed", f"{type(error).__name__}: {error}"))


def _render_views(
    renderer: BlenderScene,
    scene: RenderScene | None,
    pixels: NDArray[np.float32],
    textured: bool,
    views: list[SubpixelView],
    effort: RenderSettings,
) -> None:
    if scene is None:
        raise RuntimeError("there is no scene yet")
    width, height = scene.camera.size
    shape = (len(views), height, width, effort.channels)
    count = int(np.prod(shape))
    textures = None
    if textured:
        form = (len(scene.lamp.circles), *scene.lamp.texture_shape, 3)
        textures = pixels[count : count + int(np.prod(form))].reshape(form)
    renderer.render(scene, textures, views, effort, pixels[:count].reshape(shape))


def _end_with(socket: int) -> None:
    """End at once when the other end of the socket is closed, even in the middle of a render."""
    watch = select.poll()
    watch.register(socket, 0)

    def wait() -> None:
        watch.poll()
        os._exit(0)

    threading.Thread(target=wait, daemon=True).start()


def main(arguments: list[str]) -> None:
    """Serve on the inherited socket and memory."""
    socket, memory = map(int, arguments)
    warnings.simplefilter("ignore", DeprecationWarning)
    _end_with(socket)
    try:
        serve_renders(Connection(socket), memory)
    except (EOFError, OSError):
        os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1:])
