"""Frames of a session that are what they should be, and their projector coordinates."""

from __future__ import annotations

from dataclasses import replace

from fpplab.calibration.model import Calibration
from fpplab.core.depth import DepthInterval
from fpplab.core.errors import DataError
from fpplab.core.progress import Progress, no_progress
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.pipeline.checking import plan_fault, require_in_step
from fpplab.pipeline.depth import given_depth
from fpplab.sessions.origin import check_region, check_stage
from fpplab.sessions.session import Session


def checked_recording(
    session: Session,
    calibration: Calibration,
    depth_mm: DepthInterval | None,
    progress: Progress,
    *,
    as_recorded: bool = False,
) -> Recording:
    # `depth_mm` replaces the range of depths that plan or rig state.
    given = given_depth(depth_mm)
    calibration.check_camera(session.format[:2], session.path)
    calibration.check_projector(*session.projector(), session.path)
    check_region(calibration, session)
    check_stage(calibration, session.plan, session.path)
    recording = session.recording(progress=lambda share: progress(0.3 * share))
    if not as_recorded:
        require_in_step(recording)
    return replace(recording, depth=given) if given else recording


def decode_session(
    session: Session, progress: Progress = no_progress, *, as_recorded: bool = False
) -> Decoded:
    """Find the projector coordinates of every camera pixel of a session."""
    # returns (height, width)
    recording, _ = recording_and_fault(session, progress, as_recorded=as_recorded)
    return decode(recording, lambda share: progress(0.5 + 0.5 * share))


def recording_and_fault(
    session: Session, progress: Progress, *, as_recorded: bool
) -> tuple[Recording, str | None]:
    """Read the frames of a session, and say what is wrong with their plan if they are taken as recorded."""
    recording = session.recording(progress=lambda share: progress(0.5 * share))
    if not as_recorded:
        require_in_step(recording)
    fault = plan_fault(recording)
    if fault and not as_recorded:
        raise DataError(f"{session.path}: {fault}; --as-recorded decodes it nevertheless")
    return recording, fault
