"""See by one pose of the board whether a rig is as it was characterised, and correct the calibration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.files import refuse_existing
from fpplab.results.observer import Observer

if TYPE_CHECKING:
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.results.check import BoardCheckResult

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
    from fpplab.workflows.correct import CorrectionRequest, run_correction
    from fpplab.workflows.judge import JudgementRequest, run_judgement

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
