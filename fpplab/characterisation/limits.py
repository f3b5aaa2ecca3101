"""Limits by which a characterisation accepts, rejects and warns, as one value."""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

from pydantic import Field

from fpplab.core.config import Document, Positive

Chance = Annotated[float, Field(gt=0.0, lt=1.0)]  # a probability
PartOfOne = Annotated[float, Field(gt=0.0, le=1.0)]  # a part of a whole


class CharacterisationLimits(Document):
    """Limits of a characterisation; each one says where its value comes from."""

    max_focal_uncertainty: PartOfOne = 0.03
    """Relative standard uncertainty of a focal length that is accepted. Chosen."""
    max_camera_rms_px: Positive = 1.0
    """RMS in px of the camera alone, above which other descriptions of the board are tried. Chosen."""
    min_description_gain: Positive = 4.0
    """How many times better another description of the board must fit to be the right one. Chosen."""
    max_description_rms_px: Positive = 3.0
    """RMS in px of the camera above which another description of the board is wrong as well. Chosen."""
    max_pose_rms_ratio: Positive = 4.0
    """RMS of a pose relative to the median, above which it is left out. Chosen: something has changed."""
    max_residual_sigmas: Positive = 5.0
    """Standard deviations beyond which a point is rejected. Derived: noise exceeds them once in 270 000."""
    min_rejected_px: Positive = 0.02
    """Error in px of a point that is rejected, however small the others' scatter. Chosen."""
    max_rejected_share: PartOfOne = 0.1
    """Share of a pose's points that may be rejected. Chosen: if more are wrong, the pose itself is."""
    max_modulation_gradient: Positive = 0.12
    """Relative gradient of the modulation in 1/px. Derived: blur shifts the phase by its square times the
    gradient, and steeper pixels mix the phases of two surfaces."""
    min_plane_share: PartOfOne = 0.5
    """Share of the board's pixels whose fringe orders must fit one plane. Chosen."""
    max_chance: Chance = 1e-4
    """Probability below which chance does not explain what was seen: the motion of a board, another scale in
    some poses, an uncertainty that is too small. Chosen: chance reaches it once in 10 000 times."""
    min_focus_poses: Annotated[int, Field(ge=3)] = 5
    """Poses from which it is concluded that the focus of the lens changed. Derived: one is left out."""
    max_focus_breathing: Positive = 1e-4
    """Scatter of the scale between poses that is reported. Chosen: 0.1 px at 1000 px from the centre."""
    min_tilt_deg: Positive = 15.0
    """Greatest tilt below which a warning is given. Derived: focal length and distance are correlated."""
    min_tilt_spread_deg: Positive = 20.0
    """Greatest difference of tilt below which a warning is given. Chosen: all poses tell nearly the same."""
    parallel_deg: Positive = 4.0
    """Difference of tilt below which poses are parallel and do not determine the focal lengths. Chosen."""
    min_distance_range: PartOfOne = 0.05
    """Range of distances, as a share of their mean, below which a warning is given. Chosen."""


@dataclass(frozen=True)
class PoseLimits:
    """Limits by which a guide judges a pose before the board is put away, and tells poses apart."""

    max_residual_ratio: float = 2.0
    """Residuals relative to those predicted, above which a pose is rejected unless by chance. Chosen."""
    certain_poses: int = 6
    """Poses by which the devices have to be determined, and from which a pose that contradicts them is the
    wrong one. Chosen: twice as many as are needed."""
    similar_mm: float = 15.0
    """Distance in mm below which candidates are excluded with a pose. Chosen: what a hand holds apart."""
    similar_deg: float = 12.0  # rotation in degrees below which they are, as `similar_mm`


class LocalFitLimits(NamedTuple):
    """Limits of the fit of projector coordinates around a point, read by compiled functions."""

    window_pitches: float = 0.8  # half the side of the window, in pitches of the board (chosen)
    min_pixels: int = 40  # pixels that a fit of six coefficients needs to reject outliers (chosen)
    max_off_centre: float = 0.35
    """How far the middle of the valid pixels may be from the point, in half sides of the window. Chosen."""
    max_median_ratio: float = 4 * 1.4826
    """Residual beyond which a pixel is left out, in medians of absolute ones. Derived: 4 sigmas."""
    max_rounds: int = 4  # how often outliers are left out (chosen)


USUAL_LIMITS = CharacterisationLimits()
POSE_LIMITS = PoseLimits()
LOCAL_FIT_LIMITS = LocalFitLimits()
