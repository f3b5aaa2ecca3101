"""`--view` and `--keep-open`, and what follows the workflows of commands: progress bars and the viewer."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from fpplab.cli import console
from fpplab.core.extras import need_extra
from fpplab.core.progress import Progress
from fpplab.results.observer import Observer

if TYPE_CHECKING:
    from fpplab.calibration.model import Calibration
    from fpplab.core.conventions import Lattice
    from fpplab.devices import Frame
    from fpplab.patterns.plan import Plan
    from fpplab.phase import Decoded
    from fpplab.viewer.canvas import CommandView
    from fpplab.viewer.measurement import MeasurementView
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


class ConsoleObserver(Observer):
    """Shows progress and messages on stderr."""

    def stage(self, name: str) -> AbstractContextManager[Progress]:
        """Show a progress bar."""
        return console.progress(name)

    def message(self, sentence: str) -> None:
        """Print a sentence."""
        console.log_status(sentence)


class MeasurementObserver(ConsoleObserver):
    """Shows a measurement in the viewer, too."""

    def __init__(self, viewer: Viewer[Any], view: type[MeasurementView]) -> None:
        self._viewer, self._view = viewer, view
        self._has_maps = False

    def plan(self, plan: Plan, size: tuple[int, int], lattice: Lattice) -> None:
        """Show what will be projected."""
        self._viewer.show(self._view.plan, plan, size, lattice)

    def calibration(self, calibration: Calibration) -> None:
        """Show both devices."""
        self._viewer.show(self._view.calibration, calibration)

    def frame(self, frame: Frame) -> None:
        """Show a frame."""
        from fpplab.viewer.measurement import ShownFrame

        self._viewer.show_one_of_many(self._view.frame, ShownFrame.of(frame))

    def maps(self, decoded: Decoded) -> None:
        """Show projector coordinates."""
        self._has_maps = True
        self._viewer.show(self._view.maps, decoded)

    def result(self, result: object) -> None:
        """Show the points."""
        from fpplab.results.scan import ScanResult

        if isinstance(result, ScanResult) and result.cloud is not None:
            decoded = None if self._has_maps else result.decoded
            self._viewer.show(self._view.results, decoded, result.cloud, result.depth, None)


def observe_measurement(
    context: typer.Context, wanted: bool, keep_open: bool, recording: Path | None
) -> Observer:
    """Make what follows a measurement: the terminal, and the viewer where it is asked for."""
    if not (wanted or keep_open):
        return ConsoleObserver()
    need_extra("rerun")
    from fpplab.viewer.measurement import MeasurementView

    viewer = open_viewer(context, MeasurementView, wanted, keep_open, recording)
    return MeasurementObserver(viewer, MeasurementView)
