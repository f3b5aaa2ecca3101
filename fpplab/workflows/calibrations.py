"""Judge, correct and combine calibrations that were made before."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.files import refuse_existing, removed_on_failure
from fpplab.results.observer import Observer

if TYPE_CHECKING:
    from fpplab.results.characterisation import CombinationResult, CorrectionResult, JudgementResult
    from fpplab.targets import Target


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


@dataclass(frozen=True)
class CorrectionRequest:
    """Which calibration to correct, by which sessions, and where the corrected one goes."""

    calibration: Path
    sessions: tuple[Path, ...]  # one per pose, or the folder that holds them
    out: Path
    force: bool = False  # whether existing files are replaced
    marks: tuple[Path, Target] | None = None  # session that shows reference marks, and their print

    @property
    def page(self) -> Path:
        return self.out.with_suffix(".html")


def run_correction(request: CorrectionRequest, observer: Observer | None = None) -> CorrectionResult:
    """Find what has changed since a calibration was made, and write the corrected one and a report."""
    from fpplab.calibration.model import Calibration
    from fpplab.pipeline.characterising import correct_by_sessions
    from fpplab.pipeline.marks import locate_session_marks
    from fpplab.report.characterisation import write_judgement_report
    from fpplab.results.characterisation import CorrectionResult, JudgementResult
    from fpplab.results.provenance import poses_provenance
    from fpplab.sessions.origin import calibration_origin
    from fpplab.sessions.session import recorded_sessions

    observer = observer or Observer()
    for path in (request.out, request.page):
        refuse_existing(path, request.force)
    calibration = Calibration.load(request.calibration)
    with observer.stage("Correcting") as progress:
        sessions = recorded_sessions(list(request.sessions))
        correction = correct_by_sessions(sessions, calibration, request.calibration, progress)
    for reason in correction.after.left_out.values():
        observer.message(f"left out: {reason}")
    corrected = replace(correction.calibration, origin=calibration_origin(sessions))
    if request.marks is not None:
        (session,) = recorded_sessions([request.marks[0]])
        corrected = locate_session_marks(session, request.marks[1], corrected)
    elif calibration.marks is not None and corrected.marks is None:
        observer.message(
            "the corrected calibration has no reference marks; add '--marks SCAN', which shows them with "
            "fringes along x and y"
        )
    correction = replace(correction, calibration=corrected)
    provenance = poses_provenance(sessions, corrected, request.out)
    judged = JudgementResult(correction.after, provenance, request.page)
    write_judgement_report(request.page, request.out.stem, judged)
    with removed_on_failure(request.page):
        corrected.save(request.out)  # last: its existence means that all is done
    return CorrectionResult(correction, provenance, request.out, request.page)


@dataclass(frozen=True)
class CombinationRequest:
    """Which calibrations to combine, and where the new one goes."""

    calibrations: tuple[Path, ...]
    out: Path
    force: bool = False  # whether an existing file is replaced


def run_combination(request: CombinationRequest, observer: Observer | None = None) -> CombinationResult:
    """Find the mean of several calibrations and what varies between them, and write the new one."""
    from fpplab.calibration.model import Calibration
    from fpplab.characterisation import combine
    from fpplab.results.characterisation import CombinationResult

    observer = observer or Observer()
    refuse_existing(request.out, request.force)
    calibrations = [Calibration.load(path) for path in request.calibrations]
    with observer.stage("Combining") as progress:
        combination = combine(calibrations, list(map(str, request.calibrations)))
        progress(1.0)
    combination.calibration.save(request.out)
    return CombinationResult(combination, request.calibrations, request.out)
