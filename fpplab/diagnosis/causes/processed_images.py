"""The images were compressed or filtered after they were recorded."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from fpplab.core.config import Positive
from fpplab.diagnosis.evidence import Evidence
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Finding
from fpplab.diagnosis.fringe_shape import phase_error_finding
from fpplab.diagnosis.limits import LimitsSection


class ProcessedImagesLimits(LimitsSection):
    """How much phase error neighbouring pixels may share."""

    min_phase_error_rad: Positive = 0.01
    """RMS phase error by it in rad that is reported, if it exceeds the noise. Chosen."""


def _find(evidence: Evidence, before: Sequence[Finding]) -> Iterator[Finding]:
    sample = evidence.frames
    if before or not sample.measured.any():
        return  # light that changes, and rows of other frames, are shared by neighbours too
    finest = sample.recording.plan.finest_set()
    errors = sample.errors.sets[finest]
    rad = math.hypot(
        errors.ripple_rad, math.sqrt(max(errors.scatter - 1.0, 0.0)) * sample.phase_noise(finest)
    )
    min_rad = evidence.limits.of(ProcessedImagesLimits).min_phase_error_rad
    text = "errors that neighbouring pixels share, as compression and noise reduction leave them,"
    if (finding := phase_error_finding(sample, PROCESSED_IMAGES, rad, min_rad, text)) is not None:
        yield replace(finding, evidence=finding.evidence + evidence.contained_cost(rad))


PROCESSED_IMAGES = FaultCause(
    key="processed_images",
    meaning="The images were compressed or filtered after they were recorded.",
    remedy="record without loss, as PNG or TIFF, and switch off image processing in camera and "
    "programs: noise reduction, sharpening, scaling",
    measured="errors in the phase of the finest fringes that neighbouring pixels share",
    limit=f"{ProcessedImagesLimits().min_phase_error_rad:g} rad, and the noise",
    seen_in="frames",
    detectors=(Detector(DetectionStage.BLUR, _find),),  # after what changes light and frames
    shown_by="the verdict's sentence",
)
