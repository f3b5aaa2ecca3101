"""The fringe coordinate hardly changes with depth."""

from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.core.config import Positive
from fpplab.core.drawing import ACCENT, HALF, SECOND, single_axes
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.limits import LimitsSection
from fpplab.diagnosis.pictures import draw_limit


class WrongAxisLimits(LimitsSection):
    """How much of the change with depth a plan should see."""

    min_sensitivity: Positive = 0.5
    """Change of the plan's coordinates with depth, as a share of the greatest. Derived: noise in depth is
    then twice as large as it need be."""


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    by_depth, plan = evidence.points.px_per_mm_of_depth, evidence.plan
    limit = evidence.limits.of(WrongAxisLimits).min_sensitivity
    coded = [by_depth["xy".index(axis)] for axis in plan.axes]
    share = float(np.linalg.norm(coded) / np.linalg.norm(by_depth))
    if share < limit:
        text = (
            f"fringes along {plan.axes[0]} see {100 * share:.0f} % of the change of the projector's "
            f"coordinate with depth (at least {100 * limit:g} %): noise in depth is "
            f"{1 / share:.1f} times as large as it need be"
        )
        yield Finding(WRONG_AXIS, text, limit / max(share, 1e-3))


def _draw(evidence: Evidence, _: Finding) -> Figure:
    by_depth, axes_of_plan = evidence.points.px_per_mm_of_depth, evidence.frames.recording.plan.axes
    is_coded = [axis in axes_of_plan for axis in "xy"]
    names = [f"{axis}{', of the plan' if coded else ''}" for axis, coded in zip("xy", is_coded, strict=True)]
    figure, axes = single_axes(HALF, 1.8)
    axes.barh(names, by_depth, color=[ACCENT if coded else SECOND for coded in is_coded], height=0.6)
    share = evidence.limits.of(WrongAxisLimits).min_sensitivity
    draw_limit(axes, share * float(np.linalg.norm(by_depth)), "least of the plan")
    axes.set(xlabel="change of the projector's coordinate in px per mm of depth")
    return figure


WRONG_AXIS = FaultCause(
    key="wrong_axis",
    meaning="The fringe coordinate hardly changes with depth.",
    remedy="use a plan with fringes along the other axis, or along both",
    measured="change of the coordinate with depth along the axis of the plan, relative to the largest",
    limit="half",
    seen_in="points",
    detectors=(Detector(DetectionStage.POINTS, _find),),
    picture=Picture(Needs.POINTS, _draw),
)
