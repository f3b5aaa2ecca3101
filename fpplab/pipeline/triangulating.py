"""Points of a recording without uncertainty, or why there are none."""

from dataclasses import replace

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.progress import Progress
from fpplab.diagnosis import Diagnosis, diagnose_scan
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits
from fpplab.patterns.plan import FilterRules
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.pipeline.checking import plan_fault
from fpplab.reconstruction.depth_range import decoding_bounds
from fpplab.reconstruction.points import points_of


def triangulate_recording(
    recording: Recording,
    calibration: Calibration,
    filtering: bool | None,
    progress: Progress,
    limits: DiagnosisLimits = USUAL_LIMITS,
) -> tuple[Decoded, Cloud | Diagnosis]:
    """Decode and triangulate; `filtering` replaces what the plan says of its filter."""
    plan = recording.plan
    bounds = decoding_bounds(plan, calibration, recording.depth)
    try:
        decoded = decode(recording, lambda share: progress(0.3 + 0.28 * share), bounds)
    except ConfigError as error:
        if fault := plan_fault(recording):
            raise DataError(f"{recording.name}: {fault}") from error
        raise
    if filtering is not None:
        plan = plan.model_copy(update={"filter": (plan.filter or FilterRules()) if filtering else None})
    placed = decoded.of_known_order()
    if not placed.valid.any():
        return decoded, diagnose_scan(recording, decoded, None, calibration, limits=limits)
    try:
        decoded, cloud = points_of(placed, calibration, plan, recording.mean_image())
        return decoded, _coloured(cloud, recording, calibration)
    except DataError:
        diagnosis = diagnose_scan(recording, decoded, None, calibration, limits=limits)
        if not diagnosis.findings:
            raise
        return decoded, diagnosis


def _coloured(cloud: Cloud, recording: Recording, calibration: Calibration) -> Cloud:
    """Add the part's colours where the camera sees any, beside those of the board where it is known."""
    assert cloud.pixels is not None
    colours = recording.colours(cloud.pixels)
    if colours is None:
        return cloud
    levels = colours / (calibration.white or (1.0, 1.0, 1.0))
    return replace(cloud, rgb=np.rint(np.clip(levels, 0.0, 255.0)).astype(np.uint8))
