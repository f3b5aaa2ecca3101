"""The plan does not describe the images."""

from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.config import Positive
from fpplab.core.conventions import Axis
from fpplab.diagnosis.causes.flicker import FLICKER
from fpplab.diagnosis.causes.harmonics import HARMONICS
from fpplab.diagnosis.causes.response import RESPONSE
from fpplab.diagnosis.causes.wrong_orientation import WRONG_ORIENTATION
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Finding, Picture
from fpplab.diagnosis.limits import CountLimit, LimitsSection, ShareLimit
from fpplab.diagnosis.pictures import draw_phases_by_set
from fpplab.diagnosis.plan import PlanCheck, check_plan_fit
from fpplab.diagnosis.plan.edits import Edit
from fpplab.diagnosis.plan.limits import PlanCheckLimits
from fpplab.diagnosis.plan.orientation import check_orientation, steps_on_epipolar_lines
from fpplab.diagnosis.points import DirectionLimits, changes_along_image, systematic_epipolar_px
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded

EXCESS = 1e4
"""Excess of a plan that is wrong, a multiple of its limit. Derived: no point lies as far off its line. Every
other finding follows from it."""


class WrongPlanLimits(LimitsSection):
    """When the plan is checked, and how much better another one must fit."""

    min_points_share: ShareLimit = 0.8
    """Share of the lit pixels that become points, below which the plan is checked. Chosen."""
    min_directed_pixels: CountLimit = 100
    """Pixels from which the direction of the fringes is concluded. Chosen."""
    max_bent_share: Positive = 0.25
    """Share of the disagreement that a better plan leaves where the response is bent. Measured on benches:
    bent responses make sets disagree."""


def _find(evidence: Evidence, findings: Sequence[Finding]) -> Iterator[Finding]:
    # A coordinate that runs against the calibration is always noticed, and points off their epipolar lines.
    # Other plans are tried where it does, where the sets contradict each other, or few pixels become points.
    recording, decoded, calibration = evidence.recording, evidence.decoded, evidence.calibration
    assert recording is not None
    assert decoded is not None
    assert calibration is not None
    limits, reported = evidence.limits.of(WrongPlanLimits), {finding.cause for finding in findings}
    against = _runs_against(decoded, calibration, recording.plan.axes, evidence)
    if _is_off_epipolar_lines(evidence) and (
        edit := steps_on_epipolar_lines(recording, calibration, evidence.limits)
    ):
        text = (
            f"the plan does not fit its images: {edit.mistake}; so corrected, and only then, points lie on "
            f"their epipolar lines; {edit.remedy}"
        )
        yield Finding(WRONG_PLAN, text, EXCESS)
        return
    if against is None and not _is_suspicious(evidence, decoded, limits):
        return
    check = check_plan_fit(recording, evidence.limits, calibration)
    if FLICKER in reported and check is not None and _moves_origins_alone(check.better, recording.plan):
        return
    is_bent = RESPONSE in reported or HARMONICS in reported
    is_better = check is not None and not (is_bent and not _is_much_better(check, limits))
    if check is not None and is_better and check.better is not None:
        yield Finding(WRONG_PLAN, check.fault or "", EXCESS)
    elif against is not None:
        yield _other_orientation(evidence, against)


def _other_orientation(evidence: Evidence, axis: Axis) -> Finding:
    """Say why a coordinate runs against the calibration."""
    assert evidence.recording is not None
    assert evidence.calibration is not None
    tried = check_orientation(evidence.recording, evidence.calibration, evidence.limits)
    text = f"the coordinate along {axis} does not run along the image as the calibration says"
    if tried is None or not tried.fitting:
        return Finding(WRONG_ORIENTATION, text, EXCESS)
    return Finding(WRONG_ORIENTATION, f"{text}: {tried.evidence}", EXCESS, tried.remedy)


def _is_much_better(check: PlanCheck, limits: WrongPlanLimits) -> bool:
    """Whether a plan fits better than a bent response explains; true where none is."""
    return not check.better_disagreement > limits.max_bent_share * check.disagreement


def _moves_origins_alone(edit: Edit | None, plan: Plan) -> bool:
    if edit is None or edit.images or len(edit.sets) != len(plan.fringes):
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
    max_agreeing = evidence.limits.of(PlanCheckLimits).max_agreeing
    return decoded.disagreement is not None and not decoded.typical_disagreement <= max_agreeing


def _is_off_epipolar_lines(evidence: Evidence) -> bool:
    off = systematic_epipolar_px(evidence.cloud) if evidence.cloud is not None else None
    return off is not None and off > evidence.limits.of(PlanCheckLimits).max_epipolar_px


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


WRONG_PLAN = FaultCause(
    key="wrong_plan",
    meaning="The plan does not describe the images.",
    remedy="correct the plan; 'fpplab plan guess' writes one for images of another program",
    measured="disagreement of the fringe sets by the plan, compared with that by the plans next to it, also "
    "with a bent response straightened. Looked at where less than "
    f"{100 * WrongPlanLimits().min_points_share:g} % of the lit pixels become points, or the sets disagree "
    f"by {PlanCheckLimits().max_agreeing:g} times their noise",
    limit=f"{PlanCheckLimits().max_better_ratio:g} of it",
    seen_in="frames",
    detectors=(Detector(DetectionStage.PLAN, _find),),
    picture=Picture(Needs.FRAMES, draw_phases_by_set),
    side_effects=frozenset({"stale_calibration"}),
    invalidates=frozenset({DetectionStage.REFLECTIONS}),
    useless_from=1.0,
)
