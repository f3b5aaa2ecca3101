"""Reconstruct: the points of a recorded session, with their verdict, as a file with a report next to it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.arguments import object_or_file
from fpplab.core.files import need_suffix, refuse_existing, removed_on_failure
from fpplab.core.progress import Progress, ignore, no_progress
from fpplab.results.observer import Observer
from fpplab.workflows.stopwatch import Stopwatch

if TYPE_CHECKING:
    from fpplab.calibration.model import Calibration
    from fpplab.core.depth import DepthInterval
    from fpplab.diagnosis import DiagnosisLimits
    from fpplab.phase import Decoded
    from fpplab.reconstruction.depth_range import KnownPixels
    from fpplab.results.scan import ScanResult
    from fpplab.sessions.session import Session


@dataclass(frozen=True, eq=False)
class ReconstructionRequest:
    """What to reconstruct, how, and where the points go."""

    session: Session
    calibration: Calibration
    out: Path | None = None  # the cloud; a report goes next to it. Without, nothing is written
    report: bool = True  # whether it does
    depth_mm: DepthInterval | None = None  # instead of the range that plan or rig state
    filtering: bool | None = None  # instead of what the plan says of its filter
    known_mm: KnownPixels = ()  # points whose distance is known, for plans that neighbours unwrap
    as_recorded: bool = False  # whether frames that are out of step with the plan are taken as they are
    force: bool = False  # whether existing files are replaced
    limits: DiagnosisLimits | None = None  # of an expert, by which the result is judged
    calibration_file: Path | None = None  # as messages and provenance call it

    @property
    def page(self) -> Path | None:
        return None if self.out is None or not self.report else self.out.with_suffix(".html")


def run_reconstruction(request: ReconstructionRequest, observer: Observer | None = None) -> ScanResult:
    """Reconstruct and judge a session; write cloud and report where asked to, but not a useless cloud."""
    check_output(request)
    observer = observer or Observer()
    observer.plan(request.session.plan, *request.session.projector())
    observer.calibration(request.calibration)

    from fpplab.clouds import save_cloud
    from fpplab.diagnosis.limits import USUAL_LIMITS
    from fpplab.pipeline.measuring import reconstruct_session
    from fpplab.results.provenance import session_provenance
    from fpplab.results.scan import scan_result

    stopwatch = Stopwatch()
    with observer.stage("Reconstructing") as progress:
        provenance = session_provenance(request.session, request.calibration, request.calibration_file)
        reconstruction = reconstruct_session(
            request.session,
            request.calibration,
            progress,
            filtering=request.filtering,
            depth_mm=request.depth_mm,
            as_recorded=request.as_recorded,
            known_mm=request.known_mm,
            observe_maps=observer.maps,
            limits=request.limits or USUAL_LIMITS,
        )
        result = scan_result(
            reconstruction, provenance, stopwatch.seconds, cloud_file=request.out, report_file=request.page
        )
        observer.result(result)
        saved = None if result.diagnosis.is_useless else request.out
        if saved is not None and result.cloud is not None:
            with _begun_page(request.page):
                save_cloud(result.cloud, saved)
    if request.page is not None:
        from fpplab.report.scans import write_scan_report

        with (
            observer.stage("Drawing the report"),
            removed_on_failure(saved) if saved else nullcontext(),
            removed_on_failure(request.page),
        ):
            write_scan_report(request.page, result)
    return result


@contextmanager
def _begun_page(page: Path | None) -> Iterator[None]:
    """Leave a page without a report while there is none: a cloud beside it is of a run that was ended."""
    if page is None or page.exists():
        yield
        return
    from fpplab.report.page import begin_page

    begin_page(page)
    with removed_on_failure(page):
        yield


def check_output(request: ReconstructionRequest) -> None:
    """Refuse an output that cannot be written, or exists already."""
    from fpplab.clouds import CLOUD_SUFFIXES

    if request.out is None:
        return
    need_suffix(request.out, *CLOUD_SUFFIXES)
    page_exists = request.page is not None and not request.force and request.page.exists()
    if request.page is None or not page_exists:
        refuse_existing(request.out, request.force)
    else:
        from fpplab.report.page import is_report, is_unfinished

        refuse_existing(request.out, is_unfinished(request.page))
        refuse_existing(request.page, is_report(request.page))  # which useless points had alone


def reconstruct(
    session: Session | Path | str,
    calibration: Calibration | Path | str,
    progress: Progress = no_progress,
    *,
    filtering: bool | None = None,
    depth_mm: tuple[float, float] | None = None,
    as_recorded: bool = False,
    out: Path | str | None = None,
    force: bool = False,
    maps_ready: Callable[[Decoded], object] = ignore,
) -> ScanResult:
    """Decode, triangulate, filter, say how well each point is known, and whether to believe the result.

    Parameters
    ----------
    session : Session, path or str
        A complete one.
    calibration : Calibration, path or str
        Of the rig that took it.
    progress : callable
        Called with the share done, 0 … 1.
    filtering : bool, optional
        Whether points that lie on no surface are removed; by default as the session's plan says. A plan
        without rules means the usual ones.
    depth_mm : tuple of float, optional
        Least and greatest distance from the camera in mm, in which the object lies; by default as the
        session's plan or rig state.
    as_recorded : bool
        Whether frames that are out of step with the plan are taken as they are.
    out : path or str, optional
        Cloud to write (.ply, .xyz or .npz), with a report next to it, as `fpplab reconstruct` does. Without,
        nothing is written.
    force : bool
        Whether files that are there already are replaced.
    maps_ready : callable
        Given the decoded maps as soon as they are, before the points' uncertainty is computed.

    Returns
    -------
    ScanResult
        Points with their verdict. It unpacks: `decoded, cloud = reconstruct(session, calibration)`.

    Raises
    ------
    CalibrationError
        The calibration is of another rig.
    ConfigError
        The plan cannot be unwrapped in this range of depths, or needs one and has none; or the output exists.
    DataError
        Frames are missing, damaged or out of step with the plan.
    UselessScanError
        There is not a single point, or the points are useless and were to be written; it says why.
    """
    from fpplab.calibration.model import Calibration
    from fpplab.sessions.session import Session

    request = ReconstructionRequest(
        session=object_or_file(session, Session, Session.open, "session"),
        calibration=object_or_file(calibration, Calibration, Calibration.load, "calibration"),
        out=None if out is None else Path(out),
        depth_mm=depth_mm,
        filtering=filtering,
        as_recorded=as_recorded,
        force=force,
    )
    result = run_reconstruction(request, _Callbacks(progress, maps_ready))
    if result.cloud is None or request.out is not None:
        result.require_usable()
    return result


class _Callbacks(Observer):
    def __init__(self, progress: Progress, maps_ready: Callable[[Decoded], object]) -> None:
        self._progress, self._maps_ready = progress, maps_ready

    def stage(self, name: str) -> AbstractContextManager[Progress]:
        return nullcontext(self._progress)

    def maps(self, decoded: Decoded) -> None:
        self._maps_ready(decoded)
