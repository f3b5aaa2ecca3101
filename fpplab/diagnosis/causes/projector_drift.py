"""The projector's picture walks, as while it warms up."""

from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.core.conventions import Axis
from fpplab.diagnosis.causes.of_characterisation import SHOWN_BY
from fpplab.diagnosis.evidence import Evidence
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Finding
from fpplab.diagnosis.sample import FrameSample


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    if evidence.recording is None:
        return
    sample, cloud = evidence.frames, evidence.cloud
    assert cloud is not None
    by_depth, images = evidence.points.px_per_mm_of_depth, sample.recording.plan.images
    axis: Axis = "x" if by_depth[0] >= by_depth[1] else "y"  # the other one moves no point along its ray
    drift = sample.errors.drifts.get(axis)
    if drift is None:
        return
    cost_um = 1e3 * abs(drift.shift_px) / float(by_depth.max())
    others_um = 1e3 * float(np.median(0.0 if cloud.sigma_noise_mm is None else cloud.sigma_noise_mm))
    if cloud.sigma_calibration_mm is not None:  # it contains the drift
        stated_um = 1e3 * float(np.median(cloud.sigma_calibration_mm))
        others_um = float(np.sqrt(max(stated_um**2 - cost_um**2, 0.0)))
    if cost_um > others_um:
        text = (
            f"the projector's picture walks by {abs(drift.px_per_frame) * images:.2f} px along {axis} over "
            f"the {images} frames, or the part creeps; the light changes by {100 * _light(sample):+.1f} %. "
            f"Since the first frame the finest fringes have moved by {cost_um:.0f} µm along the rays, beside "
            f"{others_um:.0f} µm that are stated otherwise"
        )
        yield Finding(PROJECTOR_DRIFT, text, cost_um / max(others_um, 1e-3))


def _light(sample: FrameSample) -> float:
    """By what share the light changes over all frames, as the first and the last set show it."""
    first, last = (np.median(sample.fits[k].offset[sample.lit]) for k in (0, -1))
    starts, images = sample.recording.plan.set_starts, sample.recording.plan.images
    between = 0.5 * (starts[-2] + images - starts[1])
    return float((last / first - 1.0) * images / between) if between else 0.0


PROJECTOR_DRIFT = FaultCause(
    key="projector_drift",
    meaning="The projector image drifts during a scan or between poses.",
    remedy="warm up the projector for half an hour with its light on, fix projector, cables and "
    "part, and measure again; use reference marks to verify the geometry. A plan with few "
    "steps shows drift if its finest set is both first and last",
    measured="displacement by a ramp of phase over the frames of a set; shifts of the projector "
    "coordinates between poses at constant image scale, without the worst pose. Both are "
    "included in the uncertainty",
    limit="a chance of 1 in 10,000 by noise and vibration; in a scan also the other stated uncertainty",
    seen_in="points, characterise",
    detectors=(Detector(DetectionStage.POINTS, _find),),
    shown_by=f"{SHOWN_BY}; in a scan the evidence alone",
    side_effects=frozenset({"flicker", "stale_calibration", "wrong_resolution", "interreflection"}),
)
