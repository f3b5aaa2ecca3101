"""Edges and fringes are equally blurred."""

from collections.abc import Iterator, Sequence

from fpplab.diagnosis.blur import BlurLimits, phase_error_of_blur
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Finding, Picture
from fpplab.diagnosis.pictures import draw_focus


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    blur = evidence.blur
    if blur is None or blur.edges_px is None or not blur.is_out_of_focus or not blur.is_camera:
        return
    of_noise_in_focus = blur.sharp_contrast / max(blur.contrast, 1e-3)
    error = phase_error_of_blur(evidence.frames, blur.edges_px) * of_noise_in_focus
    useless = error >= evidence.limits.of(BlurLimits).useless_phase_error
    yield Finding(CAMERA_FOCUS, blur.evidence, blur.excess, ruins_points=useless)


CAMERA_FOCUS = FaultCause(
    key="camera_focus",
    meaning="The camera is out of focus: edges are as blurred as the fringes.",
    remedy="focus the camera at the distance of the part, or close its aperture; then characterise again",
    measured="contrast of the finest fringes relative to the widest, where edges in the image are "
    "equally blurred",
    limit="half of the contrast in focus",
    seen_in="frames",
    detectors=(Detector(DetectionStage.BLUR, _find),),
    picture=Picture(Needs.FRAMES, draw_focus),
    side_effects=frozenset({"wrong_resolution", "stale_calibration"}),
    useless_from=2.0,  # a quarter of the contrast in focus
)
