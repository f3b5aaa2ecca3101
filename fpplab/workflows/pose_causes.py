"""What the frames of poses say about a fit to them, for the workflows that fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from fpplab.core.errors import CalibrationError, FppError
from fpplab.core.progress import Progress
from fpplab.results.observer import Observer

if TYPE_CHECKING:
    from fpplab.diagnosis import Diagnosis, Finding
    from fpplab.patterns.recording import Recording
    from fpplab.sessions.session import Session


def diagnosed_poses(
    sessions: Sequence[Session],
    warnings: Sequence[str],
    left_out: Mapping[str, str],
    of_fit: Sequence[Finding],
    observer: Observer,
) -> Diagnosis:
    """Judge a characterisation by the frames of its poses, and by the result of its fit."""
    from fpplab.diagnosis import diagnose_poses

    with observer.stage("Checking the frames") as progress:
        return diagnose_poses(_recordings(sessions, progress), warnings, left_out, of_fit)


def _recordings(sessions: Sequence[Session], progress: Progress) -> Iterator[tuple[str, Recording]]:
    for number, session in enumerate(sessions, 1):
        yield session.path.name, session.recording(verify=False)
        progress(number / len(sessions))


def with_causes(error: CalibrationError, sessions: Sequence[Session], observer: Observer) -> CalibrationError:
    """Add to an error of the fit what is wrong with the frames, which may be its cause."""
    try:
        diagnosis = diagnosed_poses(sessions, [str(error)], {}, (), observer)
    except FppError:  # frames that cannot be read were the error itself
        return error
    causes = "".join(f"; {finding.sentence}; {finding.remedy}" for finding in diagnosis.findings[:2])
    explained = CalibrationError(f"{error}{causes}")
    explained.details = {**diagnosis.summary(), "verdict": "useless", "reason": str(error)}
    return explained
