"""The plan does not describe the images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.config import Positive
from fpplab.core.conventions import Axis
from fpplab.diagnosis.causes.flicker import FLICKER
from fpplab.diagnosis.causes.harmonics import HARMONICS
from fpplab.diagnosis.causes.response import RESPONSE
from fpplab.diagnosis.direction import DirectionLimits, changes_along_image
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Finding, Picture
from fpplab.diagnosis.limits import CountLimit, LimitsSection, ShareLimit
from fpplab.diagnosis.plan import PlanCheck, check_plan_fit
from fpplab.diagnosis.plan.edits import Edit
from fpplab.diagnosis.plan.limits import PlanCheckLimits
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXCESS = 1e3
"""Excess of a plan that is wrong, a multiple of its limit. Chosen: above those of other causes, since every
other finding follows from it."""


class WrongPlanLimits(LimitsSection):
    """When the plan is checked, and how much better another one must fit."""

    section: ClassVar[str] = "wrong_plan"

    min_points_share: ShareLimit = 0.5
    """Share of the lit pixels that become points, below which the plan is checked. Chosen."""
    max_disagreement: Positive = 3.0
    """Typical disagreement of the sets, in units of what noise explains, above which it is checked.
    Chosen."""
    min_directed_pixels: CountLimit = 100
    """Pixels from which the direction of the fringes is concluded. Chosen."""
    max_bent_share: Positive = 0.25
    """Share of the disagreement that a better plan leaves where the response is bent. Measured on benches
    of the limits: bent responses make sets disagree."""


def _find(evidence: Evidence, findings: Sequence[Finding]) -> Iterator[Finding]:
    """A plan that is not that of the images.

    A coordinate that runs against the calibration is always noticed. Other plans are tried where it does,
    where the sets contradict each other, or where few pixels become points.
    """
    recording, decoded, calibration = evidence.recording, evidence.decoded, evidence.calibration
    assert recording is not None
    assert decoded is not None
    assert calibration is not None
    limits, reported = evidence.limits.of(WrongPlanLimits), {finding.cause for finding in findings}
    against = _runs_against(decoded, calibration, recording.plan.axes, evidence)
    if against is None and not _is_suspicious(evidence, decoded, limits):
        return
    check = check_plan_fit(recording, evidence.limits)
    if FLICKER in reported and check is not None and _moves_origins_alone(check.better, recording.plan):
        return
    is_bent = RESPONSE in reported or HARMONICS in reported
    if is_bent and check is not None and not _is_much_better(check, limits):
        return
    if check is not None and check.fault is not None:
        yield Finding(WRONG_PLAN, check.fault, EXCESS)
        return
    if against is None:
        return
    text = (
        f"the coordinate along {against} does not run along the image as the calibration says: camera and "
        "projector stand otherwise than the calibration says, or the plan is wrong"
    )
    if check is not None and check.unusual is not None:
        text += f": {check.unusual.mistake}; {check.unusual.remedy}"
    yield Finding(WRONG_PLAN, text, EXCESS)


def _is_much_better(check: PlanCheck, limits: WrongPlanLimits) -> bool:
    """Whether a plan fits better than a bent response explains; true where none is."""
    return not check.better_disagreement > limits.max_bent_share * check.disagreement


def _moves_origins_alone(edit: Edit | None, plan: Plan) -> bool:
    if edit is None or len(edit.sets) != len(plan.fringes):
        return False
    unmoved = {"phase_origin_rad": 0.0}
    pairs = zip(edit.sets, plan.fringes, strict=True)
    return all(a.model_copy(update=unmoved) == b.model_copy(update=unmoved) for a, b in pairs)


def _is_suspicious(evidence: Evidence, decoded: Decoded, limits: WrongPlanLimits) -> bool:
    cloud = evidence.cloud
    if cloud is None or len(cloud) < limits.min_points_share * evidence.frames.estimate_pixels_seeing_fringes(
        cloud
    ):
        return True
    return decoded.disagreement is not None and not decoded.typical_disagreement <= limits.max_disagreement


def _runs_against(
    decoded: Decoded, calibration: Calibration, axes: tuple[Axis, ...], evidence: Evidence
) -> Axis | None:
    """Find the axis along which the coordinate changes as on no surface that both devices see."""
    min_pixels = evidence.limits.of(WrongPlanLimits).min_directed_pixels
    min_change = evidence.limits.of(DirectionLimits).min_change
    for axis in axes:
        shares = changes_along_image(decoded.coordinate(axis), calibration, axis, stride=8)
        finite = np.isfinite(shares)
        if finite.sum() >= min_pixels and np.median(shares[finite]) < min_change:
            return axis
    return None


def _draw(evidence: Evidence, _: Finding) -> Figure:
    """The wrapped phase of every fringe set, under the axis and number of stripes of the plan."""
    from fpplab.core.drawing import new_figure

    sample = evidence.frames
    sets = sample.recording.plan.fringes
    columns = min(len(sets), 3)
    rows = -(-len(sets) // columns)
    figure = new_figure(2.4 * columns, 2.0 * rows)
    panels = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel()
    for axes, fringe, fit in zip(panels, sets, sample.fits, strict=False):
        axes.imshow(np.where(sample.lit, fit.phase, np.nan), cmap="twilight", vmin=-np.pi, vmax=np.pi)
        axes.set_title(f"plan: {fringe.stripes:g} stripes along {fringe.axis}", fontsize=8)
    for axes in panels:
        axes.set_axis_off()
    return figure


WRONG_PLAN = FaultCause(
    key="wrong_plan",
    meaning="The plan does not describe the images.",
    remedy="correct the plan; 'fpplab plan guess' writes one for images of another program",
    measured="disagreement of the fringe sets by the plan, compared with that by the plans next to it; the "
    "direction of the fringes compared with the calibration's. Looked at where less than half of the lit "
    f"pixels become points, or the sets disagree by {WrongPlanLimits().max_disagreement:g} times their noise",
    limit=f"{PlanCheckLimits().max_better_ratio:g} of it",
    seen_in="frames",
    detectors=(Detector(DetectionStage.PLAN, _find),),
    picture=Picture(Needs.FRAMES, _draw),
    side_effects=frozenset({"stale_calibration"}),
    invalidates=frozenset({DetectionStage.REFLECTIONS}),
    useless_from=1.0,
)
