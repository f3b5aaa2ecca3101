"""`--view` and `--keep-open`, and what follows the workflows of commands: progress bars and the viewer."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

import typer

from fpplab.cli import console
from fpplab.cli.completion import option
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
    from fpplab.viewer.server import ViewerPlace
    from fpplab.viewer.viewer import Viewer

    V = TypeVar("V", bound=CommandView)
else:
    V = TypeVar("V")

ViewOption = Annotated[
    bool, option("--view", "Show progress live in the viewer, and save a recording for `fpplab view`.")
]
KeepOpen = Annotated[
    bool,
    option("--keep-open", "As --view, but keep the viewer open until it is closed or Ctrl-C is pressed."),
]


def open_viewer(
    context: typer.Context, view: type[V], requested: bool, keep_open: bool, recording: Path | None
) -> Viewer[V]:
    """Make the viewer of a command; it is closed when the command has ended, after its answer."""
    if requested or keep_open:
        need_extra("rerun")
    from fpplab.viewer.viewer import Viewer

    shown: ViewerPlace | None = "anywhere" if requested or keep_open else None
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
        return console.progress(name)

    def message(self, sentence: str) -> None:
        console.log_status(sentence)


class ViewObserver(ConsoleObserver):
    """Shows a workflow in the viewer, too, where there is one."""

    VIEW: ClassVar[str]  # its class and module, which loads what draws

    def __init__(self, viewer: Viewer[Any] | None) -> None:
        self._viewer = viewer

    @classmethod
    def view(cls) -> Any:
        module, _, name = cls.VIEW.rpartition(".")
        return getattr(import_module(f"fpplab.viewer.{module}"), name)

    def _show(self, method: str, *shown: object) -> None:
        if self._viewer is not None:
            self._viewer.show(getattr(self.view(), method), *shown)

    def _show_frame(self, frame: Frame, *place: object) -> None:
        if self._viewer is not None:
            from fpplab.viewer.measurement import ShownFrame

            self._viewer.show_one_of_many(self.view().frame, *place, ShownFrame.of(frame))


class MeasurementObserver(ViewObserver):
    """Shows a measurement; says whether to believe a scan's points, before its report is drawn."""

    VIEW = "measurement.MeasurementView"
    _has_maps = False

    def plan(self, plan: Plan, size: tuple[int, int], lattice: Lattice) -> None:
        self._show("plan", plan, size, lattice)

    def calibration(self, calibration: Calibration) -> None:
        self._show("calibration", calibration)

    def frame(self, frame: Frame) -> None:
        self._show_frame(frame)

    def maps(self, decoded: Decoded) -> None:
        self._has_maps = True
        self._show("maps", decoded)

    def result(self, result: object) -> None:
        from fpplab.results.scan import ScanResult

        if isinstance(result, ScanResult):
            if not result.diagnosis.is_useless:
                self.message(result.diagnosis.sentence)
            if result.cloud is not None:
                decoded = None if self._has_maps else result.decoded
                self._show("results", decoded, result.cloud, result.depth, None)
            return
        from fpplab.results.comparison import (
            ComparisonResult,
        )  # with libraries of meshes, which scans need not

        if isinstance(result, ComparisonResult):
            self._show("results", None, result.cloud, None, 1e3 * result.comparison.distances_mm)


class CharacterisationObserver(MeasurementObserver):
    """Shows poses and the fit."""

    VIEW = "characterisation.CharacterisationView"

    def result(self, result: object) -> None:
        from fpplab.characterisation import Characterisation

        if isinstance(result, Characterisation):
            self._show("result", result)


class AcceptanceObserver(MeasurementObserver):
    """Shows the positions of a standard and the fits."""

    VIEW = "acceptance.AcceptanceView"

    def result(self, result: object) -> None:
        from fpplab.comparison.acceptance import Acceptance
        from fpplab.pipeline.measuring import Reconstruction

        if isinstance(result, Reconstruction) and result.decoded and result.cloud:
            self._show("position", result.session.path.name, result.decoded, result.cloud)
        elif isinstance(result, Acceptance):
            self._show("result", result)


class ResponseObserver(ViewObserver):
    """Shows grey levels and their fit."""

    VIEW = "response.ResponseView"

    def result(self, result: object) -> None:
        from fpplab.results.response import GreyLevelFrame, ResponseResult

        if isinstance(result, GreyLevelFrame):
            self._show_frame(result.frame, result.level)
        elif isinstance(result, ResponseResult):
            self._show("response", result.response)


class SearchObserver(ViewObserver):
    """Shows and prints the epochs of a search."""

    VIEW = "search.SearchView"

    def result(self, result: object) -> None:
        from fpplab.optimisation.candidate_runner import SearchEpoch

        if isinstance(result, SearchEpoch):
            best = result.best.figures
            self.message(
                f"epoch {result.number}, {result.step}: {result.measured} candidates; best {best.images} "
                f"images, {best.surface_smcd_um:.2f} µm"
            )
            self._show("epoch", result)


def observe(
    context: typer.Context,
    kind: type[ViewObserver],
    requested: bool,
    keep_open: bool,
    recording: Path | None,
) -> Observer:
    """Follow a workflow on stderr, and in the viewer where that is asked for."""
    if not (requested or keep_open):
        return kind(None)
    return kind(open_viewer(context, kind.view(), requested, keep_open, recording))
