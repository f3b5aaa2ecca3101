"""The Blender process: answers the requests of `sim.worker` and writes pictures to shared memory.

Started as `python -m sim.blender.server`. It ends when its standard input is closed, whatever it is doing, so
that it never outlives the process that started it.
"""

from __future__ import annotations

import os
import pickle
import sys
import threading
import warnings
from contextlib import suppress
from queue import SimpleQueue
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sim.picture_memory import MemoryPlace
from sim.scene import RenderRefused, RenderScene, RenderSettings, SubpixelView
from sim.worker import BEGIN

if TYPE_CHECKING:
    from sim.blender.scene import BlenderScene


def serve_renders(requests: SimpleQueue[tuple[str, Any]], answers: IO[bytes]) -> None:
    """Answer requests until the process ends."""
    import bpy  # which may print: by now to the log

    from sim.blender.scene import BlenderScene

    def answer(verb: str, content: str | None) -> None:
        pickle.dump((verb, content), answers)
        answers.flush()

    renderer, scene = BlenderScene(), None
    place, pixels = MemoryPlace(0), np.empty(0, np.float32)
    answer("ready", bpy.app.version_string)
    while True:
        verb, content = requests.get()
        try:
            if verb == "scene":
                scene = content
                continue
            at = content.pop("place")
            if at != place:
                place, pixels = at, at.mapped()
            _render_views(renderer, scene, pixels, **content)
            answer("done", None)
        except RenderRefused as refused:
            answer("refused", str(refused))
        except Exception as error:  # noqa: BLE001 - reported to the process that asked
            answer("failed", f"{type(error).__name__}: {error}")


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


def _read(stream: IO[bytes], requests: SimpleQueue[tuple[str, Any]]) -> None:
    """Pass requests on; at their end the process ends at once, even in the middle of a render."""
    with suppress(EOFError, OSError, pickle.UnpicklingError):
        while True:
            requests.put(pickle.load(stream))
    os._exit(0)


def main() -> None:
    """Serve on standard input and output."""
    warnings.simplefilter("ignore", DeprecationWarning)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what Blender prints is no answer
    answers.write(b"\n" + BEGIN)
    requests: SimpleQueue[tuple[str, Any]] = SimpleQueue()
    threading.Thread(target=_read, args=(sys.stdin.buffer, requests), daemon=True).start()
    with suppress(OSError):  # nobody reads any more
        serve_renders(requests, answers)
    os._exit(0)


if __name__ == "__main__":
    main()
