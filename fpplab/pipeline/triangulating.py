"""From a session to its points without uncertainty, or to why there are none."""

from __future__ import annotations

from dataclasses import dataclass, replace

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.depth import DepthInterval
from fpplab.core.errors import DataError
from fpplab.core.progress import Progress
from fpplab.diagnosis import Diagnosis, diagnose_scan
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits
from fpplab.patterns.plan import FilterRules
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.pipeline.checking import require_in_step
from fpplab.pipeline.depth import given_depth
from fpplab.reconstruction.depth_range import depth_bounds
from fpplab.reconstruction.points import points_of
from fpplab.sessions.session import Session


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Maps of a recording, and its points without uncertainty, or why there are none."""

    decoded: Decoded
    points: Cloud | Diagnosis


def checked_recording(
    session: Session,
    calibration: Calibration,
    depth_mm: DepthInterval | None,
    progress: Progress,
    *,
    as_recorded: bool = False,
) -> Recording:
    """Read the frames of a session of the calibration's rig, in step with their plan.

    `depth_mm` replaces the range of depths that plan or rig state.
    """
    given = given_depth(depth_mm)
    calibration.check_camera(session.format[:2], session.path)
    calibration.check_projector(*session.projector(), session.path)
    recording = session.recording(progress=lambda share: progress(0.3 * share))
    if not as_recorded:
        require_in_step(recording)
    return replace(recording, depth=given) if given else recording


def triangulate_recording(
    recording: Recording,
    calibration: Calibration,
    filtering: bool | None,
    progress: Progress,
    limits: DiagnosisLimits = USUAL_LIMITS,
) -> Triangulation:
    """Decode and triangulate; `filtering` replaces what the plan says of its filter."""
    plan = recording.plan
    bounds = depth_bounds(plan, calibration, recording.depth)
    decoded = decode(recording, lambda share: progress(0.3 + 0.28 * share), bounds)
    if filtering is not None:
        plan = plan.model_copy(update={"filter": (plan.filter or FilterRules()) if filtering else None})
    if not decoded.valid.any():
        return Triangulation(decoded, diagnose_scan(recording, decoded, None, calibration, limits=limits))
    try:
        return Triangulation(*points_of(decoded, calibration, plan, recording.mean_image()))
    except DataError:
        diagnosis = diagnose_scan(recording, decoded, None, calibration, limits=limits)
        if not diagnosis.findings:
            raise
        return Triangulation(decoded, diagnosis)
