"""Each frame contains a remnant of the previous frame."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from fpplab.core.config import Positive
from fpplab.diagnosis.causes.flicker import FLICKER
from fpplab.diagnosis.evidence import Evidence
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Finding
from fpplab.diagnosis.fringe_shape import phase_error_finding
from fpplab.diagnosis.limits import LimitsSection


class FrameLagLimits(LimitsSection):
    """How much of the frame before may be left."""

    min_phase_error_rad: Positive = 0.01
    """RMS phase error by it in rad that is reported, if it exceeds the noise. Chosen."""


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    sample = evidence.frames
    share = 100.0 * sample.errors.lag
    rad = sample.errors.sets[sample.recording.plan.finest_set()].lag_rad
    min_rad = evidence.limits.of(FrameLagLimits).min_phase_error_rad
    text = f"{share:.1f} % of the frame before in each frame"
    if (finding := phase_error_finding(sample, FRAME_LAG, rad, min_rad, text)) is not None:
        yield replace(finding, evidence=finding.evidence + evidence.contained_cost(rad))


FRAME_LAG = FaultCause(
    key="frame_lag",
    meaning="Each frame contains a remnant of the previous frame.",
    remedy="show each pattern for longer before the exposure begins, and check that camera and "
    "projector are synchronised",
    measured="fraction of the last frame of a set that remains in the first frame of the next; phase "
    "error it causes",
    limit=f"{FrameLagLimits().min_phase_error_rad:g} rad, and the noise",
    seen_in="frames",
    detectors=(Detector(DetectionStage.FRAMES, _find),),
    picture=FLICKER.picture,
    side_effects=frozenset({"flicker", "wrong_resolution", "vibration", "bands"}),
)
