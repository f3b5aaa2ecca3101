"""`--view` and `--keep-open`: what every command that shows its work does alike."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from fpplab.cli import console
from fpplab.core.extras import need_extra

if TYPE_CHECKING:
    from fpplab.viewer.canvas import CommandView
    from fpplab.viewer.server import Shown
    from fpplab.viewer.viewer import Viewer

    V = TypeVar("V", bound=CommandView)
else:
    V = TypeVar("V")

ViewOption = Annotated[
    bool,
    typer.Option("--view", help="Watch it live in the viewer; a recording is left for `fpplab view`."),
]
KeepOpen = Annotated[
    bool,
    typer.Option("--keep-open", help="The same; the viewer stays until it is closed, or Ctrl-C."),
]


def open_viewer(
    context: typer.Context, view: type[V], wanted: bool, keep_open: bool, recording: Path | None
) -> Viewer[V]:
    """Make the viewer of a command; it is closed when the command has ended, after its answer."""
    if wanted or keep_open:
        need_extra("rerun")
    from fpplab.viewer.viewer import Viewer

    shown: Shown | None = "anywhere" if wanted or keep_open else None
    keep = recording if shown else None
    viewer = Viewer(view, shown, keep, lambda where: console.log_status(f"Watch it at {where}"))

    def finish() -> None:
        succeeded = sys.exc_info()[0] is None
        if keep_open and succeeded:
            sys.stdout.flush()
            viewer.wait(lambda where: console.log_status(f"{where}: close it, or press Ctrl-C, to end."))
        viewer.close(abort=not succeeded)

    context.call_on_close(finish)
    return viewer
