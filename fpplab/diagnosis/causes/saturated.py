"""The image is saturated."""

from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.core.drawing import draw_frame
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.visibility import GreyLevelLimits, dimming_factor


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    sample, limit = evidence.frames, evidence.limits.of(GreyLevelLimits).max_saturated_share
    share = float(sample.saturated[sample.lit].mean())
    if share > limit:
        text = f"{100 * share:.0f} % of the lit pixels are saturated (at most {100 * limit:g} %)"
        yield Finding(SATURATED, text, share / limit, factor=dimming_factor(sample))


def _draw(evidence: Evidence, _: Finding) -> Figure:
    recording = evidence.frames.recording
    return draw_frame(np.max(np.stack(recording.frames), axis=0), recording.bits)


SATURATED = FaultCause(
    key="saturated",
    meaning="The image is saturated.",
    remedy="reduce exposure_s, dim the lamp, or coat shiny parts",
    measured="fraction of the lit pixels that are saturated in a frame",
    limit=f"{100 * GreyLevelLimits().max_saturated_share:g} %",
    seen_in="frames",
    detectors=(Detector(DetectionStage.FRAMES, _find),),
    picture=Picture(Needs.FRAMES, _draw),
    side_effects=frozenset({"interreflection", "wrong_resolution", "bands", "stale_calibration"}),
)
