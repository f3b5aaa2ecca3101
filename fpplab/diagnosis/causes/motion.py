"""A part moved uniformly during the scan."""

from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.core.conventions import AXES, axis_length
from fpplab.diagnosis.evidence import Evidence
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Finding
from fpplab.patterns.motion import PartMotion
from fpplab.phase.drift import PointingDrift, phase_ramp, ramp_error_rad
from fpplab.phase.limits import MOTION as LIMITS

NOT_COMPENSATED = "; it is not compensated, since its frames do not allow it"


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    recording, cloud = evidence.recording, evidence.cloud
    if recording is None or recording.motion is None or cloud is None:
        return
    noise_mm = 0.0 if cloud.sigma_noise_mm is None else float(np.median(cloud.sigma_noise_mm))
    stated_mm = 0.0 if cloud.sigma_mm is None else float(np.median(cloud.sigma_mm))
    stated_um = 1e3 * max(noise_mm, stated_mm, 1e-6)
    worst = max(recording.motion.parts, key=lambda part: _cost_um(evidence, part))
    if _cost_um(evidence, worst) > stated_um:
        text = f"{describe_motion(evidence, worst)}, beside {stated_um:.0f} µm that are stated"
        yield Finding(MOTION, text, _cost_um(evidence, worst) / stated_um)


def _cost_um(evidence: Evidence, part: PartMotion) -> float:
    return _um_per_px(evidence) * (part.left_px if part.is_compensated else part.error_px)


def _um_per_px(evidence: Evidence) -> float:
    assert evidence.recording is not None
    axis = evidence.recording.plan.axes[0]
    return 1e3 / float(evidence.points.px_per_mm_of_depth[AXES.index(axis)])


def describe_motion(evidence: Evidence, part: PartMotion) -> str:
    """Say how far a part moved, and what of the error by that is left."""
    x, y, z = part.moved_mm
    length, (column, row) = float(np.linalg.norm(part.moved_mm)), part.middle_px
    text = (
        f"the part about pixel {column}, {row} moved by {length:.2f} mm ({x:+.2f}, {y:+.2f}, {z:+.2f}) over "
        f"the scan, {abs(part.fringes):.2f} of the finest fringes"
    )
    text += "; it is compensated" if part.is_compensated else NOT_COMPENSATED
    if not evidence.has_points:
        return text
    off_um, left_um = (_um_per_px(evidence) * px for px in (part.error_px, part.left_px))
    if part.is_compensated:
        return f"{text}: of {off_um:.0f} µm by that, {left_um:.1g} µm are left"
    return f"{text}, and costs {off_um:.0f} µm"


def unseen_motion(evidence: Evidence) -> str:
    """Say what a motion costs that the frames do not show; empty where they show it."""
    assert evidence.recording is not None
    plan, size = evidence.recording.plan, evidence.recording.projector_size
    if any(fringe.images > 3 for fringe in plan.fringes):
        return ""
    axis = plan.axes[0]
    fringe, length = plan.fringes[plan.finest_set(axis)], axis_length(size, axis)
    px_per_frame = LIMITS.min_fringes * length / fringe.stripes / plan.images
    ramp = phase_ramp(PointingDrift(px_per_frame, 0.0, 0.0), fringe, length)
    off_um = ramp_error_rad(ramp, fringe) * evidence.um_per_rad
    return (
        "motion: three steps do not show a part that moves evenly; one that moves by "
        f"{LIMITS.min_fringes:g} of the finest fringes over the scan has waves of {off_um:.0f} µm"
    )


MOTION = FaultCause(
    key="motion",
    meaning="A part moved uniformly during the scan.",
    remedy="keep the part still, or use a plan with fewer frames; uniform motion of up to two of the "
    "finest fringes is compensated if the sets have more than three steps",
    measured="displacement that minimises the residuals of the frames when each is fitted at the "
    "position where it was taken; the remaining error is included in the uncertainty",
    limit="its error after compensation, or all of it if not compensated, exceeds the stated uncertainty",
    seen_in="points",
    detectors=(Detector(DetectionStage.POINTS, _find),),
    shown_by="the evidence alone",
    side_effects=frozenset(
        {"vibration", "interreflection", "wrong_resolution", "stale_calibration", "projector_drift"}
    ),
)
