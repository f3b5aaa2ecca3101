"""The causes that a scan's own frames and points can show, each with what to do about it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class ScanCause(StrEnum):
    """What is wrong, as a short key."""

    PROJECTOR_DARK = "projector_dark"
    """No fringes in the image."""
    NO_OVERLAP = "no_overlap"
    """The projector lights next to nothing of what the camera sees."""
    STALE_CALIBRATION = "stale_calibration"
    """The rig is no longer the one that was calibrated."""
    WRONG_PLAN = "wrong_plan"
    """The plan does not describe the images."""
    WRONG_AXIS = "wrong_axis"
    """The fringes' coordinate hardly changes with depth."""
    SATURATED = "saturated"
    """The image is at its full scale."""
    UNDEREXPOSED = "underexposed"
    """The image uses a small part of its range."""
    CAMERA_FOCUS = "camera_focus"
    """Edges and fringes are blurred alike."""
    PROJECTOR_FOCUS = "projector_focus"
    """Fringes are blurred, edges are not."""
    VIBRATION = "vibration"
    """The scene moved between the fringe sets."""
    AMBIENT = "ambient"
    """Light that does not come from the projector."""
    RESPONSE = "response"
    """The fringes are no sinusoids."""
    FLICKER = "flicker"
    """Frames differ in brightness."""
    SMALL_ANGLE = "small_angle"
    """Camera and projector look from nearly the same direction."""
    UNDERSAMPLED = "undersampled"
    """The finest stripes are too narrow for the camera's pixels."""


REMEDIES = {
    ScanCause.PROJECTOR_DARK: "switch the lamp on and take off the lens cap; try 'fpplab check'",
    ScanCause.NO_OVERLAP: "turn camera and projector to the same place, at the distance of the part",
    ScanCause.STALE_CALIBRATION: "characterise the rig again; something was moved, refocused or exchanged",
    ScanCause.WRONG_PLAN: "mend the plan; 'fpplab plan guess' writes one for images of another program",
    ScanCause.WRONG_AXIS: "use a plan with fringes along the other axis, or along both",
    ScanCause.SATURATED: "shorten exposure_s, dim the lamp, or coat shiny parts",
    ScanCause.UNDEREXPOSED: "lengthen exposure_s, open the camera's aperture, or brighten the lamp",
    ScanCause.CAMERA_FOCUS: "focus the camera at the part's distance, or close its aperture; then "
    "characterise again",
    ScanCause.PROJECTOR_FOCUS: "focus the projector at the part's distance, then characterise again; or use "
    "a plan with fewer stripes",
    ScanCause.VIBRATION: "fix the part, and keep stage, fans and people still; trigger the frames",
    ScanCause.AMBIENT: "shade the scene, switch the room's lights off, or put a filter of the lamp's colour "
    "before the lens",
    ScanCause.RESPONSE: "measure the response with 'fpplab gamma' and name it in the plan, or take more "
    "steps",
    ScanCause.FLICKER: "expose for whole periods of the lamp and of the mains, and let the lamp warm up",
    ScanCause.SMALL_ANGLE: "move the projector away from the camera, to 15 to 30 degrees, and characterise "
    "again",
    ScanCause.UNDERSAMPLED: "use a plan with fewer stripes, less binning, or go nearer",
}
"""What to do, by cause."""


@dataclass(frozen=True)
class ScanFinding:
    """One thing that is wrong with a scan.

    Attributes
    ----------
    cause : ScanCause
        What is wrong.
    evidence : str
        How it shows, with the measured value and its limit.
    excess : float
        Measured value over its limit, 1 or more, by which findings are ranked.
    """

    cause: ScanCause
    evidence: str
    excess: float

    @property
    def sentence(self) -> str:
        """The cause with its evidence."""
        return f"{self.cause}: {self.evidence}"

    @property
    def remedy(self) -> str:
        """What to do."""
        return REMEDIES[self.cause]

    def summary(self) -> dict[str, str]:
        """Collect what is printed.

        Returns
        -------
        dict of str to str
            `cause`, `evidence` and `remedy`.
        """
        return {"cause": self.cause.value, "evidence": self.evidence, "remedy": self.remedy}
