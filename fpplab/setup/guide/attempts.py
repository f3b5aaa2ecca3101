"""What a guided characterisation records of each pose, and its result."""

from dataclasses import dataclass
from typing import Any

from fpplab.characterisation import Characterisation
from fpplab.characterisation.guide import PoseFit
from fpplab.core.depth import DepthInterval
from fpplab.diagnosis import Finding
from fpplab.sessions.session import Session


@dataclass(frozen=True, eq=False)
class PoseAttempt:
    """One pose that was asked for and taken."""

    name: str  # of the pose
    request: str  # what was asked for
    points: int  # points of the board that were found
    rms_px: dict[str, float]  # RMS of `camera` and `projector` in px
    fit: PoseFit | None  # residuals against those that the poses before predict; None for the first poses
    form_mm: float | None  # standard uncertainty of form in mm with this pose
    findings: tuple[Finding, ...]  # what is wrong with it
    accepted: bool  # whether it counts

    def summary(self) -> dict[str, Any]:
        fit = self.fit
        predicted = (
            {"camera": fit.camera.predicted_px, "projector": fit.projector.predicted_px} if fit else {}
        )
        return {
            "pose": self.name,
            "asked": self.request,
            "accepted": self.accepted,
            "points": self.points,
            **{f"{d}_px": self.rms_px.get(d) for d in ("camera", "projector")},
            **{f"{d}_predicted_px": predicted.get(d) for d in ("camera", "projector")},
            "form_um": in_um(self.form_mm),
            "findings": [finding.summary() for finding in self.findings],
        }


@dataclass(frozen=True, eq=False)
class GuidedRun:
    """Result of a guided characterisation."""

    result: Characterisation  # from the poses that were accepted
    sessions: tuple[Session, ...]  # of these poses
    attempts: tuple[PoseAttempt, ...]  # all poses taken, in their order
    form_mm: float  # standard uncertainty of form in mm that the calibration leaves
    scale_mm: float  # what the board's scale adds to it, in mm
    until_mm: float | None  # the uncertainty that was asked for
    depth_mm: DepthInterval  # working range of depths in mm

    @property
    def reached(self) -> bool:
        return self.until_mm is None or self.form_mm <= self.until_mm

    @property
    def sentence(self) -> str:
        near, far = self.depth_mm
        reached = (
            f"standard uncertainty of form by the calibration, from {near:.0f} to {far:.0f} mm: "
            f"{1e3 * self.form_mm:.3g} µm with {len(self.sessions)} poses; the board's scale adds "
            f"{1e3 * self.scale_mm:.3g} µm, which no pose lessens"
        )
        if self.reached:
            return reached
        asked = f"{1e3 * (self.until_mm or 0.0):.3g} µm were asked for"
        return f"{reached}; {asked}: give the same command with more --poses, which keeps those taken"

    def summary(self) -> dict[str, Any]:
        return {
            "form_um": in_um(self.form_mm),
            "scale_um": in_um(self.scale_mm),
            "until_um": in_um(self.until_mm),
            "reached": self.reached,
            "depth_mm": list(self.depth_mm),
            "attempts": [attempt.summary() for attempt in self.attempts],
        }


def in_um(length_mm: float | None) -> float | None:
    return None if length_mm is None else 1e3 * length_mm


def accepted_sentence(number: int, attempt: PoseAttempt, until_mm: float | None) -> str:
    parts = [f"pose {number}: {attempt.points} points"]
    if attempt.rms_px:
        parts.append(_residuals_text(attempt))
    now_um, until_um = in_um(attempt.form_mm), in_um(until_mm)
    if now_um is None:
        parts.append("uncertainty not known yet")
    else:
        parts.append(f"uncertainty of form {now_um:.3g} µm" + (f" -> {until_um:.3g} µm" if until_um else ""))
    parts += [f"as in the previous pose: {finding.sentence}" for finding in attempt.findings[:1]]
    return "; ".join(parts)


def rejected_sentence(number: int, attempt: PoseAttempt) -> str:
    worst, *others = attempt.findings
    more = f" (and {others[0].sentence})" if others else ""
    return f"pose {number} rejected: {worst.sentence}{more}; {worst.remedy}"


def _residuals_text(attempt: PoseAttempt) -> str:
    parts = []
    for device in ("camera", "projector"):
        errors = getattr(attempt.fit, device) if attempt.fit else None
        expected = f" ({errors.predicted_px:.3f} predicted)" if errors else ""
        parts.append(f"{device} {attempt.rms_px[device]:.3f} px{expected}")
    return ", ".join(parts)
