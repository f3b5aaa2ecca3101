"""Measure: project a plan, reconstruct, and leave the session with its cloud and report."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fpplab.core.files import refuse_existing
from fpplab.core.progress import Progress, no_progress
from fpplab.core.session_names import CLOUD, REPORT
from fpplab.results.observer import Observer
from fpplab.workflows.stopwatch import Stopwatch

if TYPE_CHECKING:
    from fpplab.calibration.model import Calibration
    from fpplab.core.depth import DepthInterval
    from fpplab.devices.rig import Mounted, Rig
    from fpplab.diagnosis import DiagnosisLimits
    from fpplab.patterns.plan import Plan
    from fpplab.results.scan import ScanResult
    from fpplab.service.order import ScanOrder
    from fpplab.sessions.session import Session


@dataclass(frozen=True, eq=False)
class ScanRequest:
    """What to measure, with what, and where the session goes."""

    rig: Rig
    plan: Plan
    calibration: Calibration
    out: Path  # folder of the session; an interrupted one is completed
    mount: Mounted | None = None  # item and pose that the rig's fixture puts up first
    depth_mm: DepthInterval | None = None  # instead of the range that plan or rig state
    force: bool = False  # whether an existing session is replaced
    report: bool = True  # whether a page is written into the session
    limits: DiagnosisLimits | None = None  # of an expert, by which the result is judged
    plan_name: str = "plan"  # as messages call it
    calibration_file: Path | None = None  # as messages and provenance call it

    @property
    def plan_for_depth(self) -> Plan:
        from fpplab.pipeline.depth import plan_with_depth

        return plan_with_depth(self.plan, self.depth_mm)

    @property
    def has_report(self) -> bool:
        """Whether a finished scan exists; its report was written last."""
        return (self.out / REPORT).is_file()


def request_of_order(
    order: ScanOrder, rig: Rig, out: Path, calibration: Path, load_calibration: Callable[[Path], Calibration]
) -> ScanRequest:
    from fpplab.core.config import validate
    from fpplab.diagnosis import load_limits
    from fpplab.patterns.plan import Plan

    return ScanRequest(
        rig=rig,
        plan=Plan.load(order.plan) if isinstance(order.plan, str) else validate(order.plan, Plan, "plan"),
        calibration=load_calibration(calibration),
        out=out,
        mount=(order.item, order.pose) if order.item else None,
        depth_mm=order.depth_mm,
        force=order.force,
        report=order.report,
        limits=load_limits(Path(order.limits)) if order.limits else None,
        plan_name=order.plan if isinstance(order.plan, str) else "plan",
        calibration_file=calibration,
    )


def run_scan(request: ScanRequest, observer: Observer | None = None) -> ScanResult:
    """Open the rig, measure, reconstruct, and leave every result but a useless cloud in the session."""
    stopwatch = Stopwatch()
    check_scan_input(request)
    with request.rig:
        return _scan_on_open_rig(request, observer or Observer(), stopwatch)


def scan_on_open_rig(request: ScanRequest, observer: Observer) -> ScanResult:
    stopwatch = Stopwatch()
    check_scan_input(request)
    return _scan_on_open_rig(request, observer, stopwatch)


def preview_scan(request: ScanRequest) -> dict[str, Any]:
    """Open the rig and say what a scan would do; nothing moves, and nothing is projected or written."""
    from fpplab.pipeline.taking import plan_stage_moves

    _check_plan_and_folder(request)
    with request.rig:
        _check_devices(request)
        return plan_stage_moves(request.rig, request.plan_for_depth, request.out, request.force)


def scan(
    rig: Rig,
    plan: Plan,
    calibration: Calibration,
    out: Path | str,
    mount: Mounted | None = None,
    *,
    depth_mm: DepthInterval | None = None,
    force: bool = False,
    report: bool = True,
    progress: Progress = no_progress,
) -> ScanResult:
    """Measure on an open rig, as `fpplab scan` does, and leave the same files in the session.

    Parameters
    ----------
    rig : Rig
        Open.
    plan : Plan
        What to project and capture.
    calibration : Calibration
        Of the rig.
    out : path or str
        Folder of the session; an interrupted one is completed.
    mount : tuple of str and int, optional
        Item and pose that the rig's fixture puts up first.
    depth_mm : tuple of float, optional
        Least and greatest distance from the camera in mm, in which the object lies; by default as plan or rig
        file state.
    force : bool
        Whether a session that exists already is replaced.
    report : bool
        Whether `report.html` is written into the session.
    progress : callable
        Called with the share done, 0 … 1.

    Returns
    -------
    ScanResult
        Points with their verdict. Attributes of the cloud are also found at the result itself.

    Raises
    ------
    ConfigError, DeviceError
        The plan does not fit the rig, the output exists, or a device fails.
    CalibrationError
        The calibration is of another rig.
    DataError
        Frames are damaged or out of step with the plan, or cannot be written.
    UselessScanError
        Nobody should use the points, which are not written; it says why.
    """
    request = ScanRequest(rig, plan, calibration, Path(out), mount, depth_mm, force, report)
    shares = {"Scanning": (0.0, 0.8), "Reconstructing": (0.8, 1.0)}
    result = scan_on_open_rig(request, ProgressObserver(progress, shares))
    result.require_usable()
    return result


class ProgressObserver(Observer):
    """Reports one share of the whole work, from those of its stages."""

    def __init__(self, progress: Progress, shares: dict[str, tuple[float, float]]) -> None:
        self._progress, self._shares = progress, shares  # where each stage begins and ends

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        begin, end = self._shares.get(name, (1.0, 1.0))
        yield lambda share: self._progress(begin + (end - begin) * share)


def check_scan_input(request: ScanRequest) -> None:
    """Refuse what can be refused before the rig is opened."""
    from fpplab.sessions.session import Session

    _check_plan_and_folder(request)
    # The report is written last: without it, all that is left may be to finish.
    if request.has_report and not Session.open(request.out).missing():
        refuse_existing(request.out, request.force)


def _check_plan_and_folder(request: ScanRequest) -> None:
    from fpplab.pipeline.depth import check_plan
    from fpplab.sessions.session import require_session_folder

    check_plan(request.plan_for_depth, request.plan_name, request.calibration, request.rig, request.depth_mm)
    require_session_folder(request.out)


def _check_devices(request: ScanRequest) -> None:
    """Refuse what does not fit the devices, before anything is projected."""
    from fpplab.sessions.origin import check_stage

    rig, source = request.rig, request.calibration_file or "calibration"
    caps = rig.projector.caps
    request.plan_for_depth.check_projector(caps.size, request.plan_name)
    request.calibration.check_camera(rig.camera.caps.size, source)
    request.calibration.check_projector(caps.size, caps.lattice, source)
    check_stage(request.calibration, request.plan, request.plan_name)
    if request.mount:
        rig.need_fixture(f"--item {request.mount[0]}").check(*request.mount)


def _scan_on_open_rig(request: ScanRequest, observer: Observer, stopwatch: Stopwatch) -> ScanResult:
    _check_devices(request)
    caps = request.rig.projector.caps
    observer.plan(request.plan_for_depth, caps.size, caps.lattice)
    observer.calibration(request.calibration)

    # Only now the heavy modules: wrong input is refused at once. A viewer loads its own meanwhile.
    from fpplab.sessions.lock import exclusive_write

    with exclusive_write(request.out):
        session = _acquire(request, observer)
        result = _finish(request, session, observer, stopwatch)
        observer.result(result)
        if request.report:
            from fpplab.report.scans import write_scan_report

            with observer.stage("Drawing the report"):
                write_scan_report(request.out / REPORT, result)
        if not result.diagnosis.is_useless:
            session.check_kept()
    return result


def _acquire(request: ScanRequest, observer: Observer) -> Session:
    from fpplab.pipeline.taking import take_or_resume_session

    with observer.stage("Scanning") as progress:
        return take_or_resume_session(
            request.rig,
            request.plan_for_depth,
            request.out,
            request.mount,
            replace_existing=request.force,
            accept_complete=request.report and not request.has_report,
            progress=progress,
            observe_frame=observer.frame,
            exposed=observer.exposed,
        )


def _finish(request: ScanRequest, session: Session, observer: Observer, stopwatch: Stopwatch) -> ScanResult:
    from fpplab.diagnosis.limits import USUAL_LIMITS
    from fpplab.pipeline.measuring import finish_scan
    from fpplab.results.provenance import session_provenance
    from fpplab.results.scan import scan_result

    with observer.stage("Reconstructing") as progress:
        provenance = session_provenance(session, request.calibration, request.calibration_file)
        reconstruction = finish_scan(
            session,
            request.calibration,
            progress,
            depth_mm=request.depth_mm,
            limits=request.limits or USUAL_LIMITS,
        )
    return scan_result(
        reconstruction,
        provenance,
        stopwatch.seconds,
        images=session.plan.frames,
        cloud_file=request.out / CLOUD,
        report_file=request.out / REPORT if request.report else None,
    )
