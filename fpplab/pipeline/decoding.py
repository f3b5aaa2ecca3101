"""Projector coordinates of a session's frames."""

from __future__ import annotations

from fpplab.core.errors import DataError
from fpplab.core.progress import Progress, no_progress
from fpplab.phase import Decoded, decode
from fpplab.pipeline.checking import plan_fault, require_in_step
from fpplab.sessions.session import Session


def decode_session(
    session: Session, progress: Progress = no_progress, *, as_recorded: bool = False
) -> Decoded:
    """Find the projector coordinates of every camera pixel of a session."""
    # returns (height, width)
    recording = session.recording(progress=lambda share: progress(0.5 * share))
    if not as_recorded:
        require_in_step(recording)
        if fault := plan_fault(recording):
            raise DataError(f"{session.path}: {fault}; --as-recorded decodes it nevertheless")
    return decode(recording, lambda share: progress(0.5 + 0.5 * share))
