"""Whether to believe a scan, and why not."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, ClassVar

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.errors import DataError
from fpplab.diagnosis.catalogue import known_causes
from fpplab.diagnosis.causes.motion import MOTION, describe_motion, unseen_motion
from fpplab.diagnosis.causes.wrong_plan import EXCESS, WRONG_PLAN
from fpplab.diagnosis.codes import NOT_SHOWN, criteria_of_codes, findings_on_geometry, lit_pixels
from fpplab.diagnosis.criteria import CriteriaLimits, Criterion, criteria_of, left_out
from fpplab.diagnosis.evidence import Evidence
from fpplab.diagnosis.finding import DetectionStage, FaultCause, Finding
from fpplab.diagnosis.geometry import GeometryCheck
from fpplab.diagnosis.islands import (
    INVISIBLE_STEP,
    ONE_FRAME,
    PLANE,
    describe_heights,
    describe_resolution,
    describe_unknown_orders,
)
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits, LimitsSection, ShareLimit
from fpplab.diagnosis.plan.code_order import code_order_fault
from fpplab.diagnosis.ranking import rank_findings
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded
from fpplab.phase.drift import can_show_drift

FRAME_STAGES = (DetectionStage.VISIBILITY, DetectionStage.COLOUR, DetectionStage.FRAMES, DetectionStage.BLUR)
"""Stages that need frames alone."""


def find_causes(
    evidence: Evidence, stages: Iterable[DetectionStage] = tuple(DetectionStage)
) -> list[Finding]:
    """Look for causes stage by stage, but for stages that a finding makes meaningless."""
    findings: list[Finding] = []
    for stage in sorted(stages):
        if not _is_possible(stage, evidence) or any(
            stage in finding.cause.invalidates for finding in findings
        ):
            continue
        before = tuple(findings)
        for cause in known_causes().values():
            for detector in cause.detectors:
                if detector.stage is not stage:
                    continue
                new = list(detector.find(evidence, before))
                if detector.replaces and new:
                    findings = [finding for finding in findings if finding.cause != cause]
                findings += new
    return findings


def _is_possible(stage: DetectionStage, evidence: Evidence) -> bool:
    if stage in (DetectionStage.REFLECTIONS, DetectionStage.POINTS):
        return evidence.has_points
    if stage is DetectionStage.PLAN:
        return evidence.calibration is not None and evidence.decoded is not None
    return True


class VerdictLimits(LimitsSection):
    """How few points make a result useless."""

    section: ClassVar[str] = "verdict"

    min_points_of_lit: ShareLimit = 0.1
    """Share of the lit pixels that become points. Chosen."""
    min_points_of_image: ShareLimit = 0.001
    """Points as a share of the image's pixels. Chosen."""


class Verdict(StrEnum):
    """Whether to believe a result."""

    GOOD = "good"
    """Nothing speaks against it, and the geometry of the rig was verified within the rig's limits."""
    UNVERIFIED = "unverified"
    """Nothing speaks against it, but nobody verified that the rig is as it was characterised."""
    DOUBTFUL = "doubtful"
    """It is worse than the rig and the plan would allow."""
    USELESS = "useless"
    """It must not be used."""


@dataclass(frozen=True)
class Diagnosis:
    """Verdict on a scan."""

    verdict: Verdict  # whether to believe it
    reason: str  # one sentence
    findings: tuple[Finding, ...]  # what is wrong, the worst first
    unknown: tuple[str, ...] = ()  # what could not be checked, and why
    criteria: tuple[Criterion, ...] = ()  # what the verdict on points was given by
    # limits of an expert that are not the usual ones, by section and name
    changed_limits: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def sentence(self) -> str:
        """The verdict with its reason."""
        return f"verdict: {self.verdict.value}: {self.reason}"

    @property
    def is_good(self) -> bool:
        """Whether nothing at all is in doubt."""
        return self.verdict is Verdict.GOOD

    @property
    def is_useless(self) -> bool:
        """Whether the result must not be used."""
        return self.verdict is Verdict.USELESS

    def require_usable(self, name: str, figures: Mapping[str, object] | None = None) -> None:
        """Refuse a result that must not be used."""
        if self.is_useless:
            raise UselessScanError(name, self, figures)

    def summary(self) -> dict[str, object]:
        """Collect what is printed."""
        criteria = {"criteria": [criterion.summary() for criterion in self.criteria]} if self.criteria else {}
        limits = {"limits": self.changed_limits} if self.changed_limits else {}
        return {
            "verdict": self.verdict.value,
            "reason": self.reason,
            "findings": [finding.summary() for finding in self.findings],
            "unverified": list(self.unknown),
            **criteria,
            **limits,
        }


class UselessScanError(DataError):
    """A result that must not be used; it is not written."""

    def __init__(self, name: str, diagnosis: Diagnosis, figures: Mapping[str, object] | None = None) -> None:
        self.name, self.diagnosis, self._figures = name, diagnosis, dict(figures or {})
        text = f"{name}: useless: {diagnosis.reason}"
        if diagnosis.findings:
            first = diagnosis.findings[0]
            text += (
                f"; {first.remedy}"
                if first.sentence == diagnosis.reason
                else (f"; {first.sentence}; {first.remedy}")
            )
        super().__init__(text)
        self.details = {**self._figures, **diagnosis.summary()}

    def __reduce__(self) -> tuple[type[UselessScanError], tuple[str, Diagnosis, dict[str, object]]]:
        """Pickle by the arguments, since errors also come from other processes."""
        return type(self), (self.name, self.diagnosis, self._figures)


def diagnosis_of(
    findings: Sequence[Finding],
    good: str,
    unknown: Sequence[str] = (),
    useless: Mapping[FaultCause, float] | None = None,
) -> Diagnosis:
    """Judge a result by what was found alone; `useless` is the excess by cause that makes it useless."""
    useless_from = useless or {}

    def is_useless(finding: Finding) -> bool:
        return finding.excess >= useless_from.get(finding.cause, math.inf)

    in_order = sorted(findings, key=lambda finding: (not is_useless(finding), -finding.excess))
    if not in_order:
        return Diagnosis(Verdict.GOOD, good, (), tuple(unknown))
    verdict = Verdict.USELESS if is_useless(in_order[0]) else Verdict.DOUBTFUL
    return Diagnosis(verdict, in_order[0].sentence, tuple(in_order), tuple(unknown))


def diagnose_frames(
    recording: Recording, decoded: Decoded | None = None, limits: DiagnosisLimits = USUAL_LIMITS
) -> tuple[Finding, ...]:
    """Look for what is wrong with the fringes of a recording alone."""
    fringes = recording.fringe_part
    if fringes is None:
        return ()
    recording = fringes
    return rank_findings(find_causes(Evidence(recording, decoded, limits=limits), FRAME_STAGES))


def diagnose_scan(
    recording: Recording,
    decoded: Decoded,
    cloud: Cloud | None,
    calibration: Calibration,
    intended: Plan | None = None,
    geometry: GeometryCheck | None = None,
    limits: DiagnosisLimits = USUAL_LIMITS,
) -> Diagnosis:
    """Judge a scan; without `geometry` it is not asked whether the rig is as it was characterised."""
    fringes, order = recording.fringe_part, code_order_fault(recording, limits)
    of_plan = [] if order is None else [Finding(WRONG_PLAN, order, EXCESS)]
    if fringes is None:
        on_geometry = findings_on_geometry(decoded, cloud, calibration, geometry, limits)
        findings = rank_findings([*of_plan, *on_geometry])
        unknown = _unknown(recording, decoded, cloud, geometry) if cloud else ()
        return _diagnose_codes(recording, decoded, cloud, findings, unknown, limits)
    evidence = Evidence(
        fringes,
        decoded,
        cloud,
        calibration,
        intended=intended,
        geometry=geometry,
        limits=limits,
    )
    findings = rank_findings([*find_causes(evidence), *of_plan])
    if cloud is None:
        judged = Diagnosis(Verdict.USELESS, "there are no points", findings)
    else:
        unknown = _unknown(recording, decoded, cloud, geometry)
        unknown += tuple(filter(None, [unseen_motion(evidence)]))
        seeing = evidence.frames.estimate_pixels_seeing_fringes(cloud)
        counted = f"{len(cloud)} points of {seeing:.0f} pixels that see the fringes"
        judged = _judge_findings(recording, limits, (len(cloud), seeing), counted, findings, unknown)
        judged = _by_criteria(judged, criteria_of(evidence.frames, decoded, cloud))
        if judged.verdict is Verdict.GOOD and geometry and geometry.doubt:
            reason = f"{counted}; geometry not verified: {geometry.doubt.reason}; {geometry.doubt.remedy}"
            judged = replace(judged, verdict=Verdict.UNVERIFIED, reason=reason)
    judged = _with_motion(judged, evidence)
    return replace(_with_islands(judged, decoded), changed_limits=limits.changes())


def _with_motion(judged: Diagnosis, evidence: Evidence) -> Diagnosis:
    """Say how parts moved, also where their frames are compensated."""
    motion = evidence.recording.motion if evidence.recording else None
    if motion is None or (judged.findings and judged.findings[0].cause == MOTION):
        return judged
    motions = (describe_motion(evidence, part) for part in motion.parts)
    return replace(judged, reason="; ".join([judged.reason, *motions]))


def _with_islands(judged: Diagnosis, decoded: Decoded) -> Diagnosis:
    """Say what neighbours and a plane could not tell; what they give is unverified at best."""
    heights = describe_heights(decoded)
    if decoded.island is None and heights is None:
        return judged
    orders = None if decoded.island is None else describe_unknown_orders(decoded.island)
    by_neighbours = (
        "fringe orders come from neighbours" if decoded.island is not None and not orders else None
    )
    verdict = Verdict.UNVERIFIED if judged.verdict is Verdict.GOOD else judged.verdict
    return replace(
        judged,
        verdict=verdict,
        reason="; ".join(filter(None, (orders, heights, judged.reason, by_neighbours))),
        unknown=(
            *judged.unknown,
            *((INVISIBLE_STEP,) * (decoded.island is not None)),
            *((PLANE,) * (heights is not None)),
        ),
    )


def _unknown(
    recording: Recording, decoded: Decoded, cloud: Cloud, geometry: GeometryCheck | None
) -> tuple[str, ...]:
    """Say what nothing in a scan shows."""
    one_axis = "stale_calibration: fringes along one axis alone do not show it"
    few_steps = "projector_drift: no fine fringe set has seven steps or is shown twice"
    unplaced = _unplaced(recording, cloud, geometry is None or geometry.region_is_known)
    is_seen = decoded.guided is not None or (geometry is not None and geometry.seen)
    part = recording.plan.fringe_part
    unknown = (one_axis,) * (cloud.epipolar_px is None and not is_seen)
    unknown += (f"region: {unplaced}",) * bool(unplaced)
    unknown += (few_steps,) * (part is None or not can_show_drift(part))
    unknown += (NOT_SHOWN,) * (part is None or part.axes != recording.plan.axes)
    return unknown + (geometry.unverified if geometry else ())


def _diagnose_codes(
    recording: Recording,
    decoded: Decoded,
    cloud: Cloud | None,
    findings: tuple[Finding, ...],
    unknown: tuple[str, ...],
    limits: DiagnosisLimits,
) -> Diagnosis:
    """Judge coordinates without fringes, which are never good: their frames show too little."""
    lit, count = lit_pixels(recording), int(decoded.valid.sum()) if cloud is None else len(cloud)
    counted = f"{count} of {lit} pixels that see the codes are measured"
    if resolution := describe_resolution(decoded):
        counted = f"{count} of {lit} pixels are measured; {resolution}"
        unknown = (*unknown, ONE_FRAME)
    judged = _judge_findings(recording, limits, (count, lit), counted, findings, unknown)
    judged = _by_criteria(judged, criteria_of_codes(decoded, cloud, lit, limits))
    if judged.verdict is Verdict.GOOD:
        judged = replace(judged, verdict=Verdict.UNVERIFIED, reason=f"{counted}; not verified: {NOT_SHOWN}")
    return replace(_with_islands(judged, decoded), changed_limits=limits.changes())


def _unplaced(recording: Recording, cloud: Cloud, region_is_known: bool) -> str:
    """Say what of the place of the images on the sensor nothing shows; empty where it is known."""
    if region_is_known and not recording.is_imported:
        return ""
    text = "that the images show the same region of the sensor as those of the characterisation"
    if recording.is_imported and cloud.epipolar_px is None:
        text += ", and are not upside down"
    return text


def diagnose_decoded(
    recording: Recording,
    decoded: Decoded,
    limits: DiagnosisLimits = USUAL_LIMITS,
    plan_fault: str | None = None,
) -> Diagnosis:
    """Judge projector coordinates by their frames, as far as that needs no calibration."""
    of_plan = [] if plan_fault is None else [Finding(WRONG_PLAN, plan_fault, EXCESS)]
    unknown = ("geometry: 'fpplab reconstruct' judges it, with a calibration",)
    fringes = recording.fringe_part
    if fringes is None:
        return _diagnose_codes(recording, decoded, None, tuple(of_plan), (*unknown, NOT_SHOWN), limits)
    evidence = Evidence(fringes, decoded, limits=limits)
    findings = rank_findings([*find_causes(evidence, FRAME_STAGES), *of_plan])
    sample, count = evidence.frames, int(decoded.valid.sum())
    seeing = sample.estimate_pixels_seeing_fringes(decoded)
    counted = f"{count} of {seeing:.0f} pixels that see the fringes are measured"
    lost = left_out(sample, decoded)
    if lost and count < sample.limits.of(CriteriaLimits).min_points_share * seeing:
        counted += f"; of the others {lost}"
    judged = _judge_findings(recording, limits, (count, seeing), counted, findings, unknown)
    judged = _by_criteria(judged, criteria_of(sample, decoded, None))
    return replace(_with_islands(judged, decoded), changed_limits=limits.changes())


def diagnose_poses(
    recordings: Iterable[tuple[str, Recording]],
    warnings: Sequence[str],
    left_out: Mapping[str, str],
    of_fit: Sequence[Finding] = (),
) -> Diagnosis:
    """Judge a characterisation by the frames of its poses, and by the findings of the fit."""
    by_cause: dict[FaultCause, list[tuple[str, Finding]]] = {}
    poses = 0
    for name, recording in recordings:
        poses += 1
        for finding in diagnose_frames(recording):
            by_cause.setdefault(finding.cause, []).append((name, finding))
    findings = rank_findings([*of_fit, *(_worst(of_poses, poses) for of_poses in by_cause.values())])
    good = Diagnosis(Verdict.GOOD, f"nothing is wrong with the frames of {poses} poses", ())
    return _unless_doubtful(good, findings, warnings, left_out)


def diagnose_points(
    poses: int, warnings: Sequence[str], left_out: Mapping[str, str], of_fit: Sequence[Finding] = ()
) -> Diagnosis:
    """Judge a characterisation from points alone, without frames, by the findings of the fit."""
    unknown = ("how the points were located: there are no frames to check",)
    good = Diagnosis(
        Verdict.GOOD, f"the points of {poses} poses agree; there were no frames to check", (), unknown
    )
    return _unless_doubtful(good, rank_findings(list(of_fit)), warnings, left_out)


def _unless_doubtful(
    good: Diagnosis, findings: tuple[Finding, ...], warnings: Sequence[str], left_out: Mapping[str, str]
) -> Diagnosis:
    reasons = [*(finding.sentence for finding in findings[:1]), *warnings, *left_out.values()]
    if not reasons:
        return good
    return replace(good, verdict=Verdict.DOUBTFUL, reason=reasons[0], findings=findings)


def _worst(of_poses: Sequence[tuple[str, Finding]], poses: int) -> Finding:
    name, worst = max(of_poses, key=lambda pose: pose[1].excess)
    return replace(worst, evidence=f"{name}: {worst.evidence}; in {len(of_poses)} of {poses} poses")


def _judge_findings(
    recording: Recording,
    all_limits: DiagnosisLimits,
    measured: tuple[int, float],
    counted: str,
    findings: tuple[Finding, ...],
    unknown: tuple[str, ...],
) -> Diagnosis:
    # measured: how many points or pixels, and how many pixels see the fringes
    limits, (count, seeing) = all_limits.of(VerdictLimits), measured
    pixels = recording.frames[0].size
    if count < max(limits.min_points_of_lit * seeing, limits.min_points_of_image * pixels):
        return Diagnosis(Verdict.USELESS, counted, findings, unknown)
    useless = [finding for finding in findings if finding.excess >= finding.cause.useless_from]
    useless += [
        finding
        for finding in findings[:1]
        if finding.ruins_points or finding.excess >= finding.cause.useless_if_first_from
    ]
    if useless:
        return Diagnosis(Verdict.USELESS, useless[0].evidence, findings, unknown)
    if findings:
        return Diagnosis(Verdict.DOUBTFUL, findings[0].sentence, findings, unknown)
    return Diagnosis(Verdict.GOOD, counted, findings, unknown)


def _by_criteria(judged: Diagnosis, criteria: tuple[Criterion, ...]) -> Diagnosis:
    """Doubt a result without findings whose figures are not those of a good one."""
    judged = replace(judged, criteria=criteria)
    unmet = [criterion for criterion in criteria if not criterion.is_met]
    if judged.verdict is not Verdict.GOOD or not unmet:
        return judged
    return replace(judged, verdict=Verdict.DOUBTFUL, reason=unmet[0].sentence)
