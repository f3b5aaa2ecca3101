"""`--view` and `--keep-open`, and what follows the workflows of commands: progress bars and the viewer."""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from contextlib import AbstractContextManager
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
    from fpplab.viewer.acceptance import AcceptanceView
    from fpplab.viewer.canvas import CommandView
    from fpplab.viewer.characterisation import CharacterisationView
    from fpplab.viewer.measurement import MeasurementView
    from fpplab.viewer.response import ResponseView
    from fpplab.viewer.search import SearchView
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


class ScanConsole(ConsoleObserver):
    """Also logs a scan's verdict, before its report is drawn."""

    def result(self, result: object) -> None:
        from fpplab.results.scan import ScanResult

        if isinstance(result, ScanResult) and not result.diagnosis.is_useless:
            console.log_verdict(result.diagnosis.sentence)


class SearchConsole(ConsoleObserver):
    """Also prints the epochs of a search."""

    def result(self, result: object) -> None:
        from fpplab.optimisation.candidate_runner import SearchEpoch

        if isinstance(result, SearchEpoch):
            best = result.best.figures
            self.message(
                f"epoch {result.number}, {result.step}: {result.measured} candidates; best {best.images} "
                f"images, {best.surface_smcd_um:.2f} µm"
            )


class ViewObserver(ConsoleObserver, ABC):
    """Shows a workflow in the viewer, too."""

    console: ClassVar[type[ConsoleObserver]] = ConsoleObserver  # what serves without a viewer

    def __init__(self, viewer: Viewer[Any]) -> None:
        self._viewer = viewer

    @staticmethod
    @abstractmethod
    def view() -> Any:
        """Load the class that draws; asked for only where there is a viewer."""

    def result(self, result: object) -> None:
        self.console().result(result)
        self._show_result(result)

    @abstractmethod
    def _show_result(self, result: object) -> None:
        """Draw a result of this workflow; others are not for this view."""

    def _show_frame(self, frame: Frame, *place: object) -> None:
        from fpplab.viewer.measurement import ShownFrame

        self._viewer.show_one_of_many(self.view().frame, *place, ShownFrame.of(frame))


class MeasurementObserver(ViewObserver):
    """Shows a measurement."""

    console = ScanConsole
    _has_maps = False

    @staticmethod
    def view() -> type[MeasurementView]:
        from fpplab.viewer.measurement import MeasurementView

        return MeasurementView

    def plan(self, plan: Plan, size: tuple[int, int], lattice: Lattice) -> None:
        self._viewer.show(self.view().plan, plan, size, lattice)

    def calibration(self, calibration: Calibration) -> None:
        self._viewer.show(self.view().calibration, calibration)

    def frame(self, frame: Frame) -> None:
        self._show_frame(frame)

    def maps(self, decoded: Decoded) -> None:
        self._has_maps = True
        self._viewer.show(self.view().maps, decoded)

    def _show_result(self, result: object) -> None:
        from fpplab.results.comparison import ComparisonResult
        from fpplab.results.scan import ScanResult

        if isinstance(result, ScanResult) and result.cloud is not None:
            decoded = None if self._has_maps else result.decoded
            self._viewer.show(self.view().results, decoded, result.cloud, result.depth, None)
        elif isinstance(result, ComparisonResult):
            errors_um = 1e3 * result.comparison.distances_mm
            self._viewer.show(self.view().results, None, result.cloud, None, errors_um)


class CharacterisationObserver(MeasurementObserver):
    """Shows poses and the fit."""

    @staticmethod
    def view() -> type[CharacterisationView]:
        from fpplab.viewer.characterisation import CharacterisationView

        return CharacterisationView

    def _show_result(self, result: object) -> None:
        from fpplab.characterisation import Characterisation

        if isinstance(result, Characterisation):
            self._viewer.show(self.view().result, result)


class AcceptanceObserver(MeasurementObserver):
    """Shows the positions of a standard and the fits."""

    @staticmethod
    def view() -> type[AcceptanceView]:
        from fpplab.viewer.acceptance import AcceptanceView

        return AcceptanceView

    def _show_result(self, result: object) -> None:
        from fpplab.comparison.acceptance import Acceptance
        from fpplab.pipeline.measuring import Reconstruction

        if isinstance(result, Reconstruction) and result.decoded and result.cloud:
            item = result.session.path.name
            self._viewer.show(self.view().position, item, result.decoded, result.cloud)
        elif isinstance(result, Acceptance):
            self._viewer.show(self.view().result, result)


class ResponseObserver(ViewObserver):
    """Shows grey levels and their fit."""

    @staticmethod
    def view() -> type[ResponseView]:
        from fpplab.viewer.response import ResponseView

        return ResponseView

    def _show_result(self, result: object) -> None:
        from fpplab.results.response import GreyLevelFrame, ResponseResult

        if isinstance(result, GreyLevelFrame):
            self._show_frame(result.frame, result.level)
        elif isinstance(result, ResponseResult):
            self._viewer.show(self.view().response, result.response)


class SearchObserver(ViewObserver):
    """Shows the epochs of a search."""

    console = SearchConsole

    @staticmethod
    def view() -> type[SearchView]:
        from fpplab.viewer.search import SearchView

        return SearchView

    def _show_result(self, result: object) -> None:
        from fpplab.optimisation.candidate_runner import SearchEpoch

        if isinstance(result, SearchEpoch):
            self._viewer.show(self.view().epoch, result)


def make_observer(
    context: typer.Context,
    kind: type[ViewObserver],
    requested: bool,
    keep_open: bool,
    recording: Path | None,
) -> Observer:
    """Follow a workflow on stderr, and in the viewer where that is asked for."""
    if not (requested or keep_open):
        return kind.console()
    return kind(open_viewer(context, kind.view(), requested, keep_open, recording))
