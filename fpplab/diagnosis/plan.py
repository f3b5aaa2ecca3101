"""A plan that does not describe the images of a scan."""

from __future__ import annotations

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.diagnosis.catalogue import ScanCause, ScanFinding
from fpplab.diagnosis.sample import FrameSample
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded
from fpplab.plan_check import check_plan_fit

SUSPICIOUS_SHARE = 0.5
"""Share of the lit pixels that become points, below which the plan is checked."""
DISAGREEING = 3.0
"""Typical disagreement of the sets, in units of what noise explains, above which the plan is checked."""
SAMPLING_STRIDE = 4
"""Stride in rows and columns at which the typical disagreement is sampled."""
RUINOUS = 1e3
"""Excess of a plan that is wrong: every other finding follows from it."""


def plan_finding(
    recording: Recording,
    decoded: Decoded,
    sample: FrameSample,
    cloud: Cloud | None,
    calibration: Calibration,
) -> list[ScanFinding]:
    """Try other plans where the sets contradict each other or few pixels become points.

    Parameters
    ----------
    recording : Recording
        All frames of a plan.
    decoded : Decoded
        Its projector coordinates.
    sample : FrameSample
        Of the recording.
    cloud : Cloud or None
        Its points; None where there are none.
    calibration : Calibration
        That they were triangulated with.

    Returns
    -------
    list of ScanFinding
        One where another plan fits the images, otherwise none.
    """
    if not _is_suspicious(recording, decoded, sample, cloud):
        return []
    found = check_plan_fit(recording)
    if found is None:
        return []
    if found.fault is not None:
        return [ScanFinding(ScanCause.WRONG_PLAN, found.fault, RUINOUS)]
    if found.unusual is not None and _stand_alike(calibration):
        evidence = (
            f"{found.unusual.mistake}, but by the calibration camera and projector stand alike; "
            f"{found.unusual.remedy}"
        )
        return [ScanFinding(ScanCause.WRONG_PLAN, evidence, RUINOUS)]
    return []


def _is_suspicious(recording: Recording, decoded: Decoded, sample: FrameSample, cloud: Cloud | None) -> bool:
    lit = float(sample.lit.mean()) * recording.frames[0].size
    if cloud is None or len(cloud) < SUSPICIOUS_SHARE * lit:
        return True
    if decoded.disagreement is None:
        return False
    some = decoded.disagreement[::SAMPLING_STRIDE, ::SAMPLING_STRIDE]
    known = some[np.isfinite(some)]
    return bool(known.size == 0 or np.median(known) > DISAGREEING)


def _stand_alike(calibration: Calibration) -> bool:
    """Whether the projector's columns run to the right in the image and its rows down."""
    camera, pose = calibration.camera, calibration.T_projector_camera
    middle = np.array(camera.size) / 2.0
    pixels = middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    rays = np.concatenate([camera.normalise(pixels), np.ones((3, 1))], axis=1)
    distance = 3.0 * calibration.baseline_mm
    seen = calibration.projector.project(distance * rays, pose)
    right, down = seen[1] - seen[0], seen[2] - seen[0]
    return bool(right[0] > abs(right[1]) and down[1] > abs(down[0]))
