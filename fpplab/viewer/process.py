"""The process that draws: it keeps rerun, its memory and its faults out of the process that measures.

`fpplab.viewer.viewer` starts it and writes to its standard input first an `Opening`, then pairs of a view's
method and its arguments. It answers on standard output, a line of JSON each: where it is seen, why it ended,
and whenever the operator has closed what there was to see.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import tempfile
import threading
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from fpplab.core.errors import DeviceError
from fpplab.viewer.channel import WAITING, Opening, read_message
from fpplab.viewer.server import ViewerServer, open_server

NICE = 5
"""Added to the process' niceness: the measurement has three times its share where both want the same core.
On a busy computer a higher one would leave it no time to finish the recording."""


def serve() -> None:
    """Draw what standard input says until it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # whatever a library prints is no answer
    if hasattr(os, "nice"):
        os.nice(NICE)

    def say(**words: Any) -> None:
        with suppress(OSError):
            answers.write(json.dumps(words) + "\n")

    try:
        _draw(say)
    except DeviceError as error:
        say(fault=str(error))
    except Exception as error:  # noqa: BLE001 - whatever it is, it is told, and the measurement goes on
        say(fault=" ".join(str(error).split()) or type(error).__name__)


def _draw(say: Any) -> None:
    stream = sys.stdin.buffer
    opening: Opening = read_message(stream)
    with ExitStack() as stack:
        server = open_server(opening.shown) if opening.shown else None
        if server is not None:
            stack.callback(server.stop)
            threading.Thread(target=_watch, args=(server, say), daemon=True).start()
        say(where=server.page if server else str(opening.keep))
        draft = None
        if opening.keep is not None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="fpplab-view-")))
            draft = folder / opening.keep.name
            stack.callback(_keep, draft, opening.keep)

        from fpplab.viewer.canvas import Canvas

        canvas = stack.enter_context(Canvas(server.data if server else None, draft))
        view = opening.view(canvas)
        with suppress(EOFError):
            while True:
                message = read_message(stream)
                if server and not server.runs:
                    if draft is None:
                        raise DeviceError("viewer", "show", "it was closed")
                    canvas.leave_server()
                if message == WAITING:
                    say(waiting=True)
                else:
                    method, args = message
                    method(view, *args)


def _watch(server: ViewerServer, say: Any) -> None:
    """Say whenever the window, or the last page, is closed."""
    while True:
        server.wait()
        say(closed=True)
        if not server.runs:
            return


def _keep(draft: Path, path: Path) -> None:
    """Put a complete recording in its place, if the command has left anything there."""
    if path.parent.is_dir():
        beside = path.with_name(f".{path.name}.draft")
        shutil.copyfile(draft, beside)
        os.replace(beside, path)


if __name__ == "__main__":
    serve()
    # All is written and closed. To unload the libraries would keep the command waiting for 0.3 s more.
    os._exit(0)
