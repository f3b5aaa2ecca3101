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
    """Find the projector coordinates of every camera pixel of a session.

    Parameters
    ----------
    session : Session
        A complete one.
    progress : callable
        Told the share done, 0 … 1.
    as_recorded : bool
        Whether the frames are decoded even where they are out of step with the plan or another plan fits
        them better.

    Returns
    -------
    Decoded
        Maps (height, width) of float32.

    Raises
    ------
    DataError
        Frames are missing or damaged, or do not fit the plan.
    ConfigError
        The plan cannot be unwrapped.
    """
    recording = session.recording(progress=lambda share: progress(0.5 * share))
    if not as_recorded:
        require_in_step(session, recording)
        if fault := plan_fault(recording):
            raise DataError(f"{session.path}: {fault}; --as-recorded decodes it nevertheless")
    return decode(recording, lambda share: progress(0.5 + 0.5 * share))
