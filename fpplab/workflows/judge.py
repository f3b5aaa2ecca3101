"""Judge a calibration by poses of its board that it was not fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.files import refuse_existing
from fpplab.results.observer import Observer

if TYPE_CHECKING:
    from fpplab.results.characterisation import JudgementResult


@dataclass(frozen=True)
class JudgementRequest:
    """Which calibration to judge, and by which sessions."""

    calibration: Path
    sessions: tuple[Path, ...]  # one per pose, or the folder that holds them
    page: Path | None = None  # report
    force: bool = False  # whether an existing file is replaced
    confirm: bool = False  # whether poses that agree are recorded in the calibration


def run_judgement(request: JudgementRequest, observer: Observer | None = None) -> JudgementResult:
    """Compare the errors in other poses with those that the calibration predicts."""
    from fpplab.calibration.model import Calibration
    from fpplab.pipeline.characterising import judge_sessions
    from fpplab.report.characterisation import write_judgement_report
    from fpplab.results.characterisation import JudgementResult
    from fpplab.results.provenance import poses_provenance
    from fpplab.sessions.origin import with_confirmation
    from fpplab.sessions.session import recorded_sessions

    observer = observer or Observer()
    if request.page:
        refuse_existing(request.page, request.force)
    calibration = Calibration.load(request.calibration)
    with observer.stage("Judging") as progress:
        sessions = recorded_sessions(list(request.sessions))
        judgement = judge_sessions(sessions, calibration, request.calibration, progress)
    for reason in judgement.left_out.values():
        observer.message(f"left out: {reason}")
    provenance = poses_provenance(sessions, calibration, request.calibration)
    result = JudgementResult(judgement, provenance, request.page)
    if request.page:
        write_judgement_report(request.page, request.calibration.stem, result)
    if request.confirm and not judgement.contradicted:
        with_confirmation(calibration, sessions).save(request.calibration)
        observer.message(f"{request.calibration}: now records that these poses confirm it")
    return result
