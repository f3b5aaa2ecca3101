"""What may be wrong with a rig or a scan, each cause with what to do about it.

One catalogue for every command that judges.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class FaultCause(StrEnum):
    """What is wrong, as a short key."""

    DEVICE = "device"
    """A device reported an error."""
    NO_TRIGGER = "no_trigger"
    """No trigger pulse reaches the camera."""
    TRIGGER_EDGE = "trigger_edge"
    """The camera exposes at the wrong edge of the trigger pulse."""
    CAMERA_NOT_READY = "camera_not_ready"
    """The next trigger comes before the camera is ready."""
    TRIGGER_SHIFTED = "trigger_shifted"
    """Triggered exposures begin after their patterns, or before them."""
    SLOW_DISPLAY = "slow_display"
    """The display is slower than the plan waits."""
    OUT_OF_STEP = "out_of_step"
    """Frames show other patterns than their own."""
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
    BOARD_NOT_FOUND = "board_not_found"
    """The board, or enough of its points, is not found in the frames of a pose."""
    BOARD_MOVED = "board_moved"
    """The board was not at rest while a pose was taken."""
    POSE_MISFIT = "pose_misfit"
    """A pose fits far worse than the others."""
    UNDERSAMPLED = "undersampled"
    """The finest stripes are too narrow for the camera's pixels."""
    HARMONICS = "harmonics"
    """The fringes are bent as no power law bends them."""
    INTERREFLECTION = "interreflection"
    """Parts of the scene light each other."""
    WRONG_RESOLUTION = "wrong_resolution"
    """The picture is scaled before it is shown, or the lattice of mirrors is another."""
    MISSING_COLOUR = "missing_colour"
    """Every third image is dark: one colour of the images that carry three patterns."""
    BANDS = "bands"
    """The brightness of rows differs from frame to frame."""
    MAINS_FLICKER = "mains_flicker"
    """The light follows the mains."""
    LENS_NOT_LOCKED = "lens_not_locked"
    """The image's scale differs between the poses of a characterisation."""
    SLOW_LINK = "slow_link"
    """The camera's connection carries fewer frames than the plan takes."""
    NO_PERMISSION = "no_permission"
    """The user may not open a device."""
    SLOW_DISK = "slow_disk"
    """Frames come faster than they are written."""
    FEW_POSITIONS = "few_positions"
    """A standard was measured in fewer positions than an acceptance test needs."""
    NO_LIMITS = "no_limits"
    """No maximum permissible error is stated, so that nothing is judged."""
    FORM = "form"
    """A measured sphere or plane is bent: neighbouring pixels share the error."""
    NOISE = "noise"
    """A measured sphere or plane is rough: neighbouring pixels do not share the error."""
    SCALE = "scale"
    """All lengths are wrong by the same ratio."""
    UNEVEN_LENGTHS = "uneven_lengths"
    """Lengths are wrong by a ratio that depends on where they are measured."""
    SPHERE_SIZE = "sphere_size"
    """Spheres are measured too large or too small although lengths are right."""
    ENDED_EARLY = "ended_early"
    """A fit or a search stopped before it had converged."""
    AT_BORDER = "at_border"
    """A parameter lies at the border of its range."""
    NO_GAIN = "no_gain"
    """The result is not better than where it started from."""
    UNLIKE_IMAGES = "unlike_images"
    """The images of a matched twin differ from the bench's by more than noise."""
    POINTS_MISFIT = "points_misfit"
    """Points of the board fit in the twin's images as they do not in the bench's."""
    ARTEFACT_MISFIT = "artefact_misfit"
    """The twin measures an artefact better or worse than the bench does."""
    FLAT_OPTIMUM = "flat_optimum"
    """The optimum of a search cannot be told from its neighbours."""
    LIMITS_BROKEN = "limits_broken"
    """Measured again, the optimum of a search exceeds the study's limits."""
    FAILED_CANDIDATES = "failed_candidates"
    """Many candidates of a search could not be measured."""
    NOT_CONFIRMED = "not_confirmed"
    """Where it was confirmed, the plan found is not better than that of the start."""


REMEDIES = {
    FaultCause.DEVICE: "see to its cable, power and drivers; 'fpplab devices' lists what is found",
    FaultCause.NO_TRIGGER: "check the trigger cable, the camera's `line`, its input's voltage, and the "
    "projector's output 1",
    FaultCause.TRIGGER_EDGE: "choose the other `edge` of the camera's trigger, or the other polarity "
    "(`inverted`) of the projector's output 1; see to the trigger's delay",
    FaultCause.CAMERA_NOT_READY: "state a longer `dead_time_s` in the rig file's section of the camera",
    FaultCause.TRIGGER_SHIFTED: "lessen `delay_us` and `debounce_us` of the camera's trigger, choose the "
    "edge at which a pattern begins, or use a GPIO line",
    FaultCause.SLOW_DISPLAY: "give the plan a longer settle_s",
    FaultCause.OUT_OF_STEP: "check the trigger, or give the plan a longer settle_s",
    FaultCause.PROJECTOR_DARK: "switch the lamp and its LEDs on, and take off the lens cap; try "
    "'fpplab check'",
    FaultCause.NO_OVERLAP: "turn camera and projector to the same place, at the distance of the part",
    FaultCause.STALE_CALIBRATION: "characterise the rig again; something was moved, refocused or exchanged",
    FaultCause.WRONG_PLAN: "mend the plan; 'fpplab plan guess' writes one for images of another program",
    FaultCause.WRONG_AXIS: "use a plan with fringes along the other axis, or along both",
    FaultCause.SATURATED: "shorten exposure_s, dim the lamp, or coat shiny parts",
    FaultCause.UNDEREXPOSED: "lengthen exposure_s, open the camera's aperture, or brighten the lamp",
    FaultCause.CAMERA_FOCUS: "focus the camera at the part's distance, or close its aperture; then "
    "characterise again",
    FaultCause.PROJECTOR_FOCUS: "focus the projector at the part's distance, then characterise again; or use "
    "a plan with fewer stripes",
    FaultCause.VIBRATION: "fix the part, and keep stage, fans and people still; trigger the frames",
    FaultCause.AMBIENT: "shade the scene, switch the room's lights off, or put a filter of the lamp's colour "
    "before the lens",
    FaultCause.RESPONSE: "measure the response with 'fpplab gamma' and name it in the plan, or take more "
    "steps",
    FaultCause.FLICKER: "expose for whole periods of the lamp and of the mains, and let the lamp warm up",
    FaultCause.SMALL_ANGLE: "move the projector away from the camera, to 15 to 30 degrees, and characterise "
    "again",
    FaultCause.BOARD_NOT_FOUND: "hold the whole board where the camera sees it and the projector lights "
    "it, its front towards both, nothing before it; compare it with the target file",
    FaultCause.BOARD_MOVED: "lean the board against something, or clamp it, and take the hands away until "
    "the pose is taken",
    FaultCause.POSE_MISFIT: "take the pose again; keep the board flat, and camera, projector and lenses as "
    "they are",
    FaultCause.UNDERSAMPLED: "use a plan with fewer stripes, less binning, or go nearer",
    FaultCause.HARMONICS: "switch off the projector's picture enhancement and tone curves, or use a plan of "
    "five steps or more; 'fpplab gamma' fits a power law, which does not mend this",
    FaultCause.INTERREFLECTION: "coat or turn the part so that its faces do not light each other, cover what "
    "stands beside it, or use a plan of many fine stripes alone",
    FaultCause.WRONG_RESOLUTION: "set the display to the projector's native resolution, without scaling, "
    "keystone or overscan, and state the projector's lattice as it is",
    FaultCause.MISSING_COLOUR: "see to the LED, the cable and the colour channel of every third image; send "
    "images of 24 bits",
    FaultCause.BANDS: "use a camera with a global shutter or a global reset, or expose for whole periods of "
    "the lamp and of the projector's sequence",
    FaultCause.MAINS_FLICKER: "expose for whole periods of the light, or run the lamp from direct current",
    FaultCause.LENS_NOT_LOCKED: "lock focus and aperture of both lenses, let them warm up, and take all "
    "poses anew",
    FaultCause.SLOW_LINK: "use a USB 3 port and cable, fewer bits, or a longer period between frames",
    FaultCause.NO_PERMISSION: "copy the udev rules of docs/hardware.md, join the group that they name, and "
    "plug the device in again",
    FaultCause.SLOW_DISK: "write to a local disk, or take fewer frames per second",
    FaultCause.FEW_POSITIONS: "measure the standard in more positions, spread over the measuring volume",
    FaultCause.NO_LIMITS: "state them in the standard's file, or with --mpe PF=…,SD=…",
    FaultCause.FORM: "measure the response with 'fpplab gamma', take more steps, and characterise again with "
    "poses over the whole volume; coat shiny standards",
    FaultCause.NOISE: "expose longer or open the aperture, take more steps or more stripes, and shade the "
    "scene",
    FaultCause.SCALE: "measure the spacing of the characterisation's board and correct its target file, then "
    "characterise again",
    FaultCause.UNEVEN_LENGTHS: "characterise again, with more poses that cover the whole volume, and keep "
    "temperature and lenses as they are",
    FaultCause.SPHERE_SIZE: "use matt, opaque spheres of known diameter, and look for a bent response with "
    "'fpplab check'",
    FaultCause.ENDED_EARLY: "let it go on",
    FaultCause.AT_BORDER: "widen the range",
    FaultCause.NO_GAIN: "begin elsewhere, or keep what there was",
    FaultCause.UNLIKE_IMAGES: "give the board's true pattern and material in the twin's world, and "
    "cover what else the camera sees",
    FaultCause.POINTS_MISFIT: "take the poses anew with the board at rest, and check the board against its "
    "target file",
    FaultCause.ARTEFACT_MISFIT: "give the artefact's true shape and material in the twin's world, and "
    "measure the response with 'fpplab gamma'",
    FaultCause.FLAT_OPTIMUM: "measure with more --seeds, or take any of these plans",
    FaultCause.LIMITS_BROKEN: "search with more --seeds, or with limits that leave a margin",
    FaultCause.FAILED_CANDIDATES: "narrow the study's space to what the rig measures; the journal says why "
    "each failed",
    FaultCause.NOT_CONFIRMED: "match the simulation to this rig with 'fpplab match' and search again, or "
    "search on the rig itself",
}
"""What to do, by cause."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a rig or a scan."""

    cause: FaultCause  # what is wrong
    evidence: str  # how it shows, with the measured value and its limit
    excess: float  # measured value over its limit, 1 or more, by which findings are ranked
    advice: str | None = None  # what to do in this very case; by default what the catalogue says
    factor: float | None = None  # by which to multiply the plan's exposure
    ruins_points: bool = False  # whether nobody should use the points
    behind: FaultCause | None = None  # A cause that was found too and may be all that shows here

    @property
    def sentence(self) -> str:
        """The cause with its evidence."""
        return f"{self.cause}: {self.evidence}"

    @property
    def remedy(self) -> str:
        """What to do."""
        words = self.advice or REMEDIES[self.cause]
        if self.behind:
            words = f"see to {self.behind} first, which may be all that shows here; if this remains, {words}"
        return f"{words}; multiply exposure_s by {self.factor:.2g}" if self.factor else words

    def summary(self) -> dict[str, str]:
        """Collect what is printed."""
        return {"cause": self.cause.value, "evidence": self.evidence, "remedy": self.remedy}
