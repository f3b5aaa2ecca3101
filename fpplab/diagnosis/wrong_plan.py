"""A plan that does not describe the images of a scan."""

from __future__ import annotations

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.conventions import Axis, Floats, Map
from fpplab.diagnosis.catalogue import FaultCause, Finding
from fpplab.diagnosis.plan import check_plan_fit
from fpplab.diagnosis.plan.edits import Edit
from fpplab.diagnosis.sample import FrameSample
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded

SUSPICIOUS_SHARE = 0.5
"""Share of the lit pixels that become points, below which the plan is checked."""
DISAGREEING = 3.0
"""Typical disagreement of the sets, in units of what noise explains, above which the plan is checked."""
GRADIENT_STRIDE = 8
"""Stride in rows and columns at which the coordinate's change from pixel to pixel is sampled."""
FEWEST = 100
"""Fewest pixels from which the direction of the fringes is concluded."""
LEAST_CHANGE = 0.1
"""Least typical change of a coordinate along the image, as a share of that on a surface at constant depth."""
DISTANCE_BASELINES = 3.0
"""Distance in baselines of the surface on which the change is computed; it hardly depends on it."""
CLEARLY_BETTER = 0.25
"""Share of the disagreement that a better plan leaves where the response is bent."""
RUINOUS = 1e3
"""Excess of a plan that is wrong: every other finding follows from it."""


def plan_finding(
    recording: Recording,
    decoded: Decoded,
    sample: FrameSample,
    cloud: Cloud | None,
    calibration: Calibration,
    flickers: bool,
    bent: bool = False,
) -> list[Finding]:
    """Find a plan that is not that of the images.

    A coordinate that runs against the calibration is always noticed. Other plans are tried where it does,
    where the sets contradict each other, or where few pixels become points.
    """
    against = _runs_against(decoded, calibration, recording.plan.axes)
    if against is None and not _is_suspicious(decoded, sample, cloud):
        return []
    found = check_plan_fit(recording)
    if flickers and found is not None and _moves_origins_alone(found.better, recording.plan):
        return []
    if bent and found is not None and found.better_disagreement > CLEARLY_BETTER * found.disagreement:
        return []
    if found is not None and found.fault is not None:
        return [Finding(FaultCause.WRONG_PLAN, found.fault, RUINOUS)]
    if against is None:
        return []
    evidence = (
        f"the coordinate along {against} does not run along the image as the calibration says, by which "
        "camera and projector stand otherwise"
    )
    if found is not None and found.unusual is not None:
        evidence += f": {found.unusual.mistake}; {found.unusual.remedy}"
    return [Finding(FaultCause.WRONG_PLAN, evidence, RUINOUS)]


def _moves_origins_alone(edit: Edit | None, plan: Plan) -> bool:
    if edit is None or len(edit.sets) != len(plan.fringes):
        return False
    unmoved = {"phase_origin_rad": 0.0}
    pairs = zip(edit.sets, plan.fringes, strict=True)
    return all(a.model_copy(update=unmoved) == b.model_copy(update=unmoved) for a, b in pairs)


def _is_suspicious(decoded: Decoded, sample: FrameSample, cloud: Cloud | None) -> bool:
    if cloud is None or len(cloud) < SUSPICIOUS_SHARE * sample.pixels_seeing_fringes(cloud):
        return True
    return decoded.disagreement is not None and not decoded.typical_disagreement <= DISAGREEING


def _runs_against(decoded: Decoded, calibration: Calibration, axes: tuple[Axis, ...]) -> Axis | None:
    """Find the axis along which the coordinate changes as on no surface that both devices see."""
    for axis in axes:
        shares = changes_along_image(decoded.coordinate(axis), calibration, axis, GRADIENT_STRIDE)
        known = np.isfinite(shares)
        if known.sum() >= FEWEST and np.median(shares[known]) < LEAST_CHANGE:
            return axis
    return None


def changes_along_image(coordinate: Map, calibration: Calibration, axis: Axis, stride: int) -> Floats:
    """Compare the change of the coordinate along the image with that which the calibration tells.

    On a surface at constant depth the calibration tells how the coordinate changes along the image. A slope
    of the surface makes it change faster or slower, but never backwards: both devices see its front.
    """
    # coordinate (height, width) px; returns (rows, columns)
    here = coordinate[:-1:stride, :-1:stride].astype(np.float64)
    right = coordinate[:-1:stride, 1::stride][:, : here.shape[1]] - here
    down = coordinate[1::stride, :-1:stride][: here.shape[0]] - here
    wanted = _change_along_image(calibration)["xy".index(axis)]
    return np.asarray((right * wanted[0] + down * wanted[1]) / (wanted @ wanted))


def _change_along_image(calibration: Calibration) -> Floats:
    """Change of the projector's coordinates (u, v) by a pixel to the right and down, (2, 2)."""
    camera, pose = calibration.camera, calibration.T_projector_camera
    pixels = np.array(camera.size) / 2.0 + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    rays = np.concatenate([camera.normalise(pixels), np.ones((3, 1))], axis=1)
    seen = calibration.projector.project(DISTANCE_BASELINES * calibration.baseline_mm * rays, pose)
    return np.stack([seen[1] - seen[0], seen[2] - seen[0]], axis=1)
