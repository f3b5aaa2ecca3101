"""The process that draws: it keeps rerun, its memory and its faults out of the process that measures.

Its standard input is pickled: an `Opening`, then pairs of a view's method and its arguments. It reports on
standard output, a line of JSON each: where it is shown, why it ended, and whenever the view was closed.
"""

import json
import os
import pickle
import shutil
import signal
import sys
import tempfile
import threading
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from fpplab.core.errors import DeviceError
from fpplab.core.files import replace_file
from fpplab.viewer.messages import WAITING, Opening
from fpplab.viewer.server import ViewerServer, open_server


def serve() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    reports = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what libraries print is no report
    # The measurement gets three times the viewer's share where both want the same core; with a niceness of
    # more than 5, a busy computer would leave the viewer no time to finish the recording.
    if hasattr(os, "nice"):
        os.nice(5)

    def report(**values: Any) -> None:
        with suppress(OSError):
            reports.write(json.dumps(values) + "\n")

    try:
        _draw(report)
    except DeviceError as error:
        report(fault=str(error))
    except Exception as error:  # noqa: BLE001 - whatever it is, it is reported, and the measurement goes on
        report(fault=" ".join(str(error).split()) or type(error).__name__)


def _draw(report: Any) -> None:
    opening: Opening = pickle.load(sys.stdin.buffer)
    with ExitStack() as stack:
        server = open_server(opening.shown) if opening.shown else None
        if server is not None:
            stack.callback(server.stop)
            threading.Thread(target=_watch, args=(server, report), daemon=True).start()
        report(where=server.page if server else str(opening.recording))
        draft = None
        if opening.recording is not None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="fpplab-view-")))
            draft = folder / opening.recording.name
            stack.callback(_publish, draft, opening.recording)

        from fpplab.viewer.canvas import Canvas

        canvas = stack.enter_context(Canvas(server.send if server else None, draft))
        view = opening.view(canvas)
        canvas.pass_on()
        # The pipe ends with the command, in the middle of a message if it was killed.
        with suppress(EOFError, pickle.UnpicklingError):
            while True:
                message = pickle.load(sys.stdin.buffer)
                if server and not server.runs:
                    if draft is None:
                        raise DeviceError("viewer", "show", "it was closed")
                    canvas.leave_server()
                if message == WAITING:
                    report(waiting=True)
                else:
                    method, args = message
                    method(view, *args)
                    canvas.pass_on()


def _watch(server: ViewerServer, report: Any) -> None:
    while True:
        server.wait()
        report(closed=True)
        if not server.runs:
            return


def _publish(draft: Path, path: Path) -> None:
    """Put a complete recording in its place, unless the command has removed the folder."""
    if path.parent.is_dir():
        copy = path.with_name(f".{path.name}.draft")
        shutil.copyfile(draft, copy)
        replace_file(copy, path)


if __name__ == "__main__":
    serve()
    # All is written and closed. To unload the libraries would keep the command waiting for 0.3 s more.
    os._exit(0)
