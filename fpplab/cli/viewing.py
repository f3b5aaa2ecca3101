"""`--view` and `--keep-open`, and what follows the workflows of commands: progress bars and the viewer."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

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


class VerdictObserver(ConsoleObserver):
    """Says whether to believe a scan's points, before its report is drawn."""

    def result(self, result: object) -> None:
        from fpplab.results.scan import ScanResult

        if isinstance(result, ScanResult) and not result.diagnosis.is_useless:
            console.log_status(result.diagnosis.sentence)


class MeasurementObserver(VerdictObserver):
    """Shows a measurement in the viewer, too."""

    def __init__(self, viewer: Viewer[Any], view: type[MeasurementView]) -> None:
        self._viewer, self._view = viewer, view
        self._has_maps = False

    def plan(self, plan: Plan, size: tuple[int, int], lattice: Lattice) -> None:
        self._viewer.show(self._view.plan, plan, size, lattice)

    def calibration(self, calibration: Calibration) -> None:
        self._viewer.show(self._view.calibration, calibration)

    def frame(self, frame: Frame) -> None:
        from fpplab.viewer.measurement import ShownFrame

        self._viewer.show_one_of_many(self._view.frame, ShownFrame.of(frame))

    def maps(self, decoded: Decoded) -> None:
        self._has_maps = True
        self._viewer.show(self._view.maps, decoded)

    def result(self, result: object) -> None:
        from fpplab.results.comparison import ComparisonResult
        from fpplab.results.scan import ScanResult

        super().result(result)
        if isinstance(result, ScanResult) and result.cloud is not None:
            decoded = None if self._has_maps else result.decoded
            self._viewer.show(self._view.results, decoded, result.cloud, result.depth, None)
        elif isinstance(result, ComparisonResult):
            errors_um = 1e3 * result.comparison.distances_mm
            self._viewer.show(self._view.results, None, result.cloud, None, errors_um)


class CharacterisationObserver(MeasurementObserver):
    """Shows poses and the fit in the viewer, too."""

    def result(self, result: object) -> None:
        from fpplab.characterisation import Characterisation
        from fpplab.viewer.characterisation import CharacterisationView

        if isinstance(result, Characterisation):
            self._viewer.show(CharacterisationView.result, result)


class AcceptanceObserver(MeasurementObserver):
    """Shows the positions of a standard and the fits in the viewer, too."""

    def result(self, result: object) -> None:
        from fpplab.comparison.acceptance import Acceptance
        from fpplab.pipeline.measuring import Reconstruction
        from fpplab.viewer.acceptance import AcceptanceView

        if isinstance(result, Reconstruction) and result.decoded and result.cloud:
            item = result.session.path.name
            self._viewer.show(AcceptanceView.position, item, result.decoded, result.cloud)
        elif isinstance(result, Acceptance):
            self._viewer.show(AcceptanceView.result, result)


class ResponseObserver(ConsoleObserver):
    """Shows grey levels and their fit in the viewer, too."""

    def __init__(self, viewer: Viewer[ResponseView]) -> None:
        self._viewer = viewer

    def result(self, result: object) -> None:
        from fpplab.results.response import GreyLevelFrame, ResponseResult
        from fpplab.viewer.measurement import ShownFrame
        from fpplab.viewer.response import ResponseView

        if isinstance(result, GreyLevelFrame):
            shown = ShownFrame.of(result.frame)
            self._viewer.show_one_of_many(ResponseView.frame, result.level, shown)
        elif isinstance(result, ResponseResult):
            self._viewer.show(ResponseView.response, result.response)


class SearchObserver(ConsoleObserver):
    """Prints the epochs of a search, and shows them in the viewer where there is one."""

    def __init__(self, viewer: Viewer[SearchView] | None) -> None:
        self._viewer = viewer

    def result(self, result: object) -> None:
        from fpplab.optimisation.candidate_runner import SearchEpoch

        if not isinstance(result, SearchEpoch):
            return
        best = result.best.figures
        self.message(
            f"epoch {result.number}, {result.step}: {result.measured} candidates; best {best.images} images, "
            f"{best.surface_smcd_um:.2f} µm"
        )
        if self._viewer is not None:
            from fpplab.viewer.search import SearchView

            self._viewer.show(SearchView.epoch, result)


def observe_measurement(
    context: typer.Context, requested: bool, keep_open: bool, recording: Path | None
) -> Observer:
    if not (requested or keep_open):
        return VerdictObserver()
    from fpplab.viewer.measurement import MeasurementView as View

    return MeasurementObserver(open_viewer(context, View, requested, keep_open, recording), View)


def observe_characterisation(
    context: typer.Context, requested: bool, keep_open: bool, recording: Path
) -> Observer:
    if not (requested or keep_open):
        return ConsoleObserver()
    from fpplab.viewer.characterisation import CharacterisationView as View

    return CharacterisationObserver(open_viewer(context, View, requested, keep_open, recording), View)


def observe_acceptance(context: typer.Context, requested: bool, keep_open: bool, recording: Path) -> Observer:
    if not (requested or keep_open):
        return ConsoleObserver()
    from fpplab.viewer.acceptance import AcceptanceView as View

    return AcceptanceObserver(open_viewer(context, View, requested, keep_open, recording), View)


def observe_response(context: typer.Context, requested: bool, keep_open: bool, recording: Path) -> Observer:
    if not (requested or keep_open):
        return ConsoleObserver()
    from fpplab.viewer.response import ResponseView

    return ResponseObserver(open_viewer(context, ResponseView, requested, keep_open, recording))


def observe_search(context: typer.Context, requested: bool, keep_open: bool, recording: Path) -> Observer:
    if not (requested or keep_open):
        return SearchObserver(None)
    from fpplab.viewer.search import SearchView

    return SearchObserver(open_viewer(context, SearchView, requested, keep_open, recording))
