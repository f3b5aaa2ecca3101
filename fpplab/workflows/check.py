"""Find out what is wrong with a rig, or by a pose of the board whether it is as it was characterised."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.files import need_suffix, refuse_existing
from fpplab.results.observer import Observer

if TYPE_CHECKING:
    from fpplab.calibration.model import Calibration
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.results.check import BoardCheckResult, CheckResult


@dataclass(frozen=True, eq=False)
class CheckRequest:
    """Which rig to check, and what to keep of it."""

    rig: Rig  # not open
    plan: Plan  # that is going to be measured with
    item: str = "grey_card"  # that the rig's fixture puts up
    calibration: Calibration | None = None  # whether it is still the rig's is checked too
    pictures: Path | None = None  # folder for a picture of each finding; a .png for one of the levels
    page: Path | None = None  # report
    force: bool = False  # whether existing files are replaced
    calibration_file: Path | None = None  # as provenance calls it


def run_check(request: CheckRequest, observer: Observer | None = None) -> CheckResult:
    """Open a rig, find out what is wrong with it, and write report and pictures where they are asked for."""
    for path in (request.pictures, request.page):
        if path:
            refuse_existing(path, request.force)
    if request.page:
        need_suffix(request.page, ".html")
    result = _check(request, observer or Observer())
    if request.pictures:
        from fpplab.report.check import write_check_pictures

        result = replace(result, picture_files=write_check_pictures(request.pictures, result))
    if request.page:
        from fpplab.report.check import write_check_report

        write_check_report(request.page, result)
    return result


def _check(request: CheckRequest, observer: Observer) -> CheckResult:
    from fpplab.results.check import CheckResult
    from fpplab.results.provenance import rig_provenance
    from fpplab.setup.rig_check.check import check_rig

    folder = request.pictures.absolute().parent if request.pictures else Path.cwd()
    with observer.stage("Checking") as progress:
        checked = check_rig(request.rig, request.plan, request.item, progress, request.calibration, folder)
    provenance = rig_provenance(
        checked.rig,
        checked.origin,
        request.plan,
        calibration=request.calibration,
        file=request.calibration_file,
    )
    return CheckResult(
        checked, request.calibration, provenance.with_values(item=request.item), report_file=request.page
    )


POSE = "pose"
"""Session in the folder of a check."""


@dataclass(frozen=True, eq=False)
class BoardCheckRequest:
    """Which rig and calibration to check, and where the pose goes."""

    rig: Rig  # not open
    plan: Plan  # for the board, along both axes
    calibration: Path
    folder: Path  # of the pose, the report, and the corrected calibration where one is due
    item: str = "board"  # that the rig's fixture puts up
    force: bool = False  # whether existing files are replaced


def run_board_check(request: BoardCheckRequest, observer: Observer | None = None) -> BoardCheckResult:
    """Take a pose of the board; record that it confirms the calibration, or correct a copy of it."""
    from fpplab.calibration.model import Calibration
    from fpplab.characterisation import judged_board
    from fpplab.pipeline.taking import take_or_resume_session
    from fpplab.results.check import BoardCheckResult
    from fpplab.workflows.calibrations import (
        CorrectionRequest,
        JudgementRequest,
        run_correction,
        run_judgement,
    )

    observer, folder, rig = observer or Observer(), request.folder, request.rig
    judged_board(Calibration.load(request.calibration), str(request.calibration))  # before the rig is opened
    refuse_existing(folder, request.force)
    with rig, observer.stage("Taking a pose") as progress:
        observer.plan(request.plan, rig.projector.caps.size, rig.projector.caps.lattice)
        mounted = (request.item, 0) if rig.fixture is not None else None
        take_or_resume_session(
            rig,
            request.plan,
            folder / POSE,
            mounted,
            replace_existing=request.force,
            progress=progress,
            observe_frame=observer.frame,
        )
    poses = (folder / POSE,)
    report = folder / "judgement.html"
    judged = run_judgement(
        JudgementRequest(request.calibration, poses, report, request.force, confirm=True), observer
    )
    if not judged.judgement.contradicted:
        return BoardCheckResult(judged, None)
    corrected = CorrectionRequest(request.calibration, poses, folder / "corrected.yaml", request.force)
    return BoardCheckResult(judged, run_correction(corrected, observer))
