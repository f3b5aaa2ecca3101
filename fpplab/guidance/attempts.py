"""What a guided characterisation records of each pose, and its result."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from fpplab.characterisation import Characterisation
from fpplab.characterisation.guide import PoseFit
from fpplab.core.depth import DepthInterval
from fpplab.diagnosis import Finding
from fpplab.sessions.session import Session


@dataclass(frozen=True, eq=False)
class PoseAttempt:
    """One pose that was asked for and taken.

    Attributes
    ----------
    name : str
        Of the pose.
    words : str
        What was asked for.
    points : int
        Points of the board that were found.
    rms_px : dict of str to float
        RMS of `camera` and `projector` in px; where it was accepted in the fit with all poses before, else
        with only its own pose fitted. Empty before they are known.
    fit : PoseFit or None
        Residuals beside those that the poses before predict; None for the first poses.
    form_mm : float or None
        Standard uncertainty of form in mm with this pose; None before it is known, and where it was rejected.
    findings : tuple of Finding
        What is wrong with it: why it was rejected, or what it shares with the pose before it.
    accepted : bool
        Whether it counts.
    """

    name: str
    words: str
    points: int
    rms_px: dict[str, float]
    fit: PoseFit | None
    form_mm: float | None
    findings: tuple[Finding, ...]
    accepted: bool

    def rejected_later(self, finding: Finding) -> PoseAttempt:
        """Take the acceptance back.

        Parameters
        ----------
        finding : Finding
            Why.

        Returns
        -------
        PoseAttempt
            The same, rejected.
        """
        return replace(self, accepted=False, findings=(finding, *self.findings))

    def summary(self) -> dict[str, Any]:
        """Collect what is printed.

        Returns
        -------
        dict of str to object
            Plain data, lengths in µm.
        """
        fit = self.fit
        predicted = (
            {"camera": fit.camera.predicted_px, "projector": fit.projector.predicted_px} if fit else {}
        )
        return {
            "pose": self.name,
            "asked": self.words,
            "accepted": self.accepted,
            "points": self.points,
            **{f"{d}_px": self.rms_px.get(d) for d in ("camera", "projector")},
            **{f"{d}_predicted_px": predicted.get(d) for d in ("camera", "projector")},
            "form_um": in_um(self.form_mm),
            "findings": [finding.summary() for finding in self.findings],
        }


@dataclass(frozen=True, eq=False)
class GuidedRun:
    """Result of a guided characterisation.

    Attributes
    ----------
    result : Characterisation
        From the poses that were accepted.
    sessions : tuple of Session
        Of these poses.
    attempts : tuple of PoseAttempt
        All poses taken, in their order.
    form_mm : float
        Standard uncertainty of form in mm that the calibration leaves, without the board's scale.
    scale_mm : float
        What the board's scale adds to it, in mm.
    until_mm : float or None
        The uncertainty that was asked for.
    depth_mm : DepthInterval
        Working range of depths in mm.
    """

    result: Characterisation
    sessions: tuple[Session, ...]
    attempts: tuple[PoseAttempt, ...]
    form_mm: float
    scale_mm: float
    until_mm: float | None
    depth_mm: DepthInterval

    @property
    def reached(self) -> bool:
        """Whether the uncertainty is as small as asked for; true where nothing was asked for."""
        return self.until_mm is None or self.form_mm <= self.until_mm

    @property
    def sentence(self) -> str:
        """What is known, beside what was asked for."""
        near, far = self.depth_mm
        known = (
            f"standard uncertainty of form by the calibration, from {near:.0f} to {far:.0f} mm: "
            f"{1e3 * self.form_mm:.3g} µm with {len(self.sessions)} poses; the board's scale adds "
            f"{1e3 * self.scale_mm:.3g} µm, which no pose lessens"
        )
        if self.reached:
            return known
        asked = f"{1e3 * (self.until_mm or 0.0):.3g} µm were asked for"
        return f"{known}; {asked}: give the same command with more --poses, which keeps those taken"

    def summary(self) -> dict[str, Any]:
        """Collect what is printed.

        Returns
        -------
        dict of str to object
            Plain data, lengths in µm but for the depths.
        """
        return {
            "form_um": in_um(self.form_mm),
            "scale_um": in_um(self.scale_mm),
            "until_um": in_um(self.until_mm),
            "reached": self.reached,
            "depth_mm": list(self.depth_mm),
            "attempts": [one.summary() for one in self.attempts],
        }


def in_um(length_mm: float | None) -> float | None:
    """Convert a length that may be unknown.

    Parameters
    ----------
    length_mm : float or None
        In mm.

    Returns
    -------
    float or None
        In µm.
    """
    return None if length_mm is None else 1e3 * length_mm
