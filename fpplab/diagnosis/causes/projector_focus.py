"""Fringes are blurred, edges are not."""

from collections.abc import Iterator, Sequence

from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Finding, Picture
from fpplab.diagnosis.pictures import draw_focus


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    blur = evidence.blur
    if blur is not None and blur.is_out_of_focus and not blur.is_camera:
        yield Finding(PROJECTOR_FOCUS, blur.evidence, blur.excess)


PROJECTOR_FOCUS = FaultCause(
    key="projector_focus",
    meaning="The projector is out of focus: the fringes are blurred, edges are not.",
    remedy="focus the projector at the distance of the part, then characterise again; or use a plan "
    "with fewer stripes",
    measured="contrast of the finest fringes relative to the widest, where edges are sharper",
    limit="half of the contrast in focus",
    seen_in="frames",
    detectors=(Detector(DetectionStage.BLUR, _find),),
    picture=Picture(Needs.FRAMES, draw_focus),
)
