"""Whether to believe a scan, and why not."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.errors import DataError
from fpplab.diagnosis.catalogue import FaultCause, Finding
from fpplab.diagnosis.criteria import Criterion, criteria_of
from fpplab.diagnosis.focus import focus_finding
from fpplab.diagnosis.geometry import PointSample, geometry_findings
from fpplab.diagnosis.light import light_findings
from fpplab.diagnosis.mirrored import with_mirrors
from fpplab.diagnosis.ranking import RUINOUS_OFFSET, ranked
from fpplab.diagnosis.sample import FrameSample
from fpplab.diagnosis.wrong_plan import plan_finding
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded

USELESS_SHARE = 0.1
"""Least share of the lit pixels that become points, in a result that is of use."""

USELESS_POINTS = 0.001
"""Least share of the image that points must cover."""

USELESS_EXCESS = {
    FaultCause.STALE_CALIBRATION: RUINOUS_OFFSET,
    FaultCause.WRONG_PLAN: 1.0,
    FaultCause.CAMERA_FOCUS: 2.0,
    FaultCause.MISSING_COLOUR: 30.0,
}
"""Excess of a finding from which on it makes a result useless however many points there are."""

USELESS_IF_FIRST = {FaultCause.WRONG_RESOLUTION: 1.6}
"""The same where no finding before it may have brought it about."""


FOREIGN_EXCESS = 5.0
"""Excess of a calibration that was made with other devices: points may be far off, or right by chance."""


class Verdict(StrEnum):
    """Whether to believe a result."""

    GOOD = "good"
    """Nothing speaks against it."""
    DOUBTFUL = "doubtful"
    """It is worse than the rig and the plan would allow."""
    USELESS = "useless"
    """Nobody should use it."""


@dataclass(frozen=True)
class Diagnosis:
    """Verdict on a scan."""

    verdict: Verdict  # whether to believe it
    reason: str  # one sentence
    findings: tuple[Finding, ...]  # what is wrong, the worst first
    unknown: tuple[str, ...] = ()  # what could not be checked, and why
    criteria: tuple[Criterion, ...] = ()  # what the verdict on points was given by

    @property
    def sentence(self) -> str:
        """The verdict with its reason."""
        return f"verdict: {self.verdict.value}: {self.reason}"

    @property
    def is_useless(self) -> bool:
        """Whether nobody should use the result."""
        return self.verdict is Verdict.USELESS

    def require_usable(self, name: str, figures: Mapping[str, object] | None = None) -> None:
        """Refuse a result that nobody should use."""
        if self.is_useless:
            raise UselessScanError(name, self, figures)

    def summary(self) -> dict[str, object]:
        """Collect what is printed."""
        criteria = {"criteria": [one.summary() for one in self.criteria]} if self.criteria else {}
        return {
            "verdict": self.verdict.value,
            "reason": self.reason,
            "findings": [finding.summary() for finding in self.findings],
            "not_checked": list(self.unknown),
            **criteria,
        }


class UselessScanError(DataError):
    """A result that nobody should use; it is not written."""

    def __init__(self, name: str, diagnosis: Diagnosis, figures: Mapping[str, object] | None = None) -> None:
        self.name, self.diagnosis, self._figures = name, diagnosis, dict(figures or {})
        words = f"{name}: useless: {diagnosis.reason}"
        if diagnosis.findings:
            first = diagnosis.findings[0]
            words += (
                f"; {first.remedy}"
                if first.sentence == diagnosis.reason
                else (f"; {first.sentence}; {first.remedy}")
            )
        super().__init__(words)
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
    """Judge a result by what was found alone."""
    ruins = useless or {}
    ranked = sorted(findings, key=lambda one: (one.excess < ruins.get(one.cause, float("inf")), -one.excess))
    if not ranked:
        return Diagnosis(Verdict.GOOD, good, (), tuple(unknown))
    first = ranked[0]
    ruinous = first.excess >= ruins.get(first.cause, float("inf"))
    verdict = Verdict.USELESS if ruinous else Verdict.DOUBTFUL
    return Diagnosis(verdict, first.sentence, tuple(ranked), tuple(unknown))


def diagnose_frames(recording: Recording, decoded: Decoded | None = None) -> tuple[Finding, ...]:
    """Look for what is wrong with the frames of a recording alone."""
    return ranked(_of_frames(FrameSample.of(recording, decoded), None))


def diagnose_scan(
    recording: Recording,
    decoded: Decoded,
    cloud: Cloud | None,
    calibration: Calibration,
    intended: Plan | None = None,
    foreign: str | None = None,
) -> Diagnosis:
    """Judge a scan."""
    plan, sample = intended or recording.plan, FrameSample.of(recording, decoded)
    points = PointSample(cloud, calibration) if cloud is not None else None
    scale = float(points.projector_px_per_px["xy".index(plan.axes[0])]) if points else None
    of_frames = _of_frames(sample, scale)
    seen = {finding.cause for finding in of_frames}
    flickers = FaultCause.FLICKER in seen
    bent = bool(seen & {FaultCause.RESPONSE, FaultCause.HARMONICS})
    wrong = (
        []
        if FaultCause.MISSING_COLOUR in seen
        else plan_finding(recording, decoded, sample, cloud, calibration, flickers, bent)
    )
    if cloud is None or points is None:
        return Diagnosis(Verdict.USELESS, "there are no points", ranked([*wrong, *of_frames]))
    if not wrong:
        of_frames = with_mirrors(of_frames, sample, calibration)
    of_devices = [_of_other_devices(foreign)] if foreign else []
    findings = ranked([*of_devices, *wrong, *of_frames, *geometry_findings(points, plan)])
    one_axis = "stale_calibration: fringes along one axis alone do not show it"
    unknown = (one_axis,) if cloud.epipolar_px is None else ()
    judged = _judged(sample, cloud, findings, unknown)
    return _by_criteria(judged, criteria_of(sample, decoded, cloud))


def _of_other_devices(how: str) -> Finding:
    advice = "give the calibration of these devices, or characterise them"
    return Finding(FaultCause.STALE_CALIBRATION, how, FOREIGN_EXCESS, advice)


def diagnose_poses(
    recordings: Iterable[tuple[str, Recording]],
    warnings: Sequence[str],
    left_out: Mapping[str, str],
    of_fit: Sequence[Finding] = (),
) -> Diagnosis:
    """Judge a characterisation by the frames of its poses, and by what the fit said."""
    found: dict[FaultCause, list[tuple[str, Finding]]] = {}
    poses = 0
    for name, recording in recordings:
        poses += 1
        for finding in diagnose_frames(recording):
            found.setdefault(finding.cause, []).append((name, finding))
    findings = ranked([*of_fit, *(_worst(seen, poses) for seen in found.values())])
    if findings:
        return Diagnosis(Verdict.DOUBTFUL, findings[0].sentence, findings)
    said = [*warnings, *left_out.values()]
    if said:
        return Diagnosis(Verdict.DOUBTFUL, said[0], ())
    return Diagnosis(Verdict.GOOD, f"nothing is wrong with the frames of {poses} poses", ())


def _worst(seen: Sequence[tuple[str, Finding]], poses: int) -> Finding:
    name, worst = max(seen, key=lambda one: one[1].excess)
    return replace(worst, evidence=f"{name}: {worst.evidence}; in {len(seen)} of {poses} poses")


def _judged(
    sample: FrameSample, cloud: Cloud, findings: tuple[Finding, ...], unknown: tuple[str, ...]
) -> Diagnosis:
    pixels = sample.recording.frames[0].size
    seeing = sample.pixels_seeing_fringes(cloud)
    share = len(cloud) / seeing
    counted = f"{len(cloud)} points of {seeing:.0f} pixels that see the fringes"
    ruinous = [f for f in findings if f.excess >= USELESS_EXCESS.get(f.cause, float("inf"))]
    first = findings[:1]
    ruinous += [f for f in first if f.ruins_points or f.excess >= USELESS_IF_FIRST.get(f.cause, float("inf"))]
    if share < USELESS_SHARE or len(cloud) < USELESS_POINTS * pixels:
        return Diagnosis(Verdict.USELESS, counted, findings, unknown)
    if ruinous:
        return Diagnosis(Verdict.USELESS, ruinous[0].evidence, findings, unknown)
    if findings:
        return Diagnosis(Verdict.DOUBTFUL, findings[0].sentence, findings, unknown)
    return Diagnosis(Verdict.GOOD, counted, findings, unknown)


def _by_criteria(judged: Diagnosis, criteria: tuple[Criterion, ...]) -> Diagnosis:
    """Doubt a result without findings whose figures are not those of a good one."""
    judged = replace(judged, criteria=criteria)
    unmet = [one for one in criteria if not one.is_met]
    if judged.verdict is not Verdict.GOOD or not unmet:
        return judged
    return replace(judged, verdict=Verdict.DOUBTFUL, reason=unmet[0].sentence)


def _of_frames(sample: FrameSample, scale: float | None) -> list[Finding]:
    findings = list(light_findings(sample))
    dark = {FaultCause.PROJECTOR_DARK, FaultCause.NO_OVERLAP}
    if not any(finding.cause in dark for finding in findings):
        focus = focus_finding(sample, scale)
        findings += [focus] if focus else []
    return findings
