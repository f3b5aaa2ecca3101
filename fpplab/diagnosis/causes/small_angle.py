"""Camera and projector view the part from nearly the same direction."""

from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.core.config import Positive
from fpplab.core.drawing import ACCENT
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.limits import LimitsSection
from fpplab.diagnosis.pictures import curve_axes, draw_limit
from fpplab.diagnosis.points import triangulation_angles_deg


class SmallAngleLimits(LimitsSection):
    """At which angle rays should meet."""

    min_angle_deg: Positive = 5.0
    """Angle between the rays in degrees. Derived: noise in depth is then four times that at 20 degrees."""


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    sample, limit = evidence.points, evidence.limits.of(SmallAngleLimits).min_angle_deg
    angle = float(np.median(triangulation_angles_deg(sample.points, sample.calibration)))
    if angle < limit:
        text = f"the rays of camera and projector meet at {angle:.1f} degrees (at least {limit:g})"
        yield Finding(SMALL_ANGLE, text, limit / max(angle, 0.1))


def _draw(evidence: Evidence, _: Finding) -> Figure:
    points = evidence.points
    figure, axes = curve_axes()
    axes.hist(triangulation_angles_deg(points.points, points.calibration), bins=60, color=ACCENT)
    draw_limit(axes, evidence.limits.of(SmallAngleLimits).min_angle_deg, "least")
    axes.set(xlabel="angle between the rays in degrees", ylabel="points")
    axes.set_xlim(left=0.0)
    return figure


SMALL_ANGLE = FaultCause(
    key="small_angle",
    meaning="Camera and projector view the part from nearly the same direction.",
    remedy="move the projector away from the camera, to an angle of 15 to 30 degrees, and characterise again",
    measured="angle between the rays of camera and projector",
    limit=f"{SmallAngleLimits().min_angle_deg:g} degrees",
    seen_in="points",
    detectors=(Detector(DetectionStage.POINTS, _find),),
    picture=Picture(Needs.POINTS, _draw),
)
