"""Diagnosis of target files that describe another board than the one in the images."""

from collections.abc import Sequence

import numpy as np

from fpplab.characterisation.limits import USUAL_LIMITS, CharacterisationLimits
from fpplab.characterisation.observation import Observation, similar_descriptions
from fpplab.characterisation.parameters import ImageSize
from fpplab.characterisation.zhang import calibrate_by_zhang, rms
from fpplab.core.errors import CalibrationError
from fpplab.targets import Target
from fpplab.targets.views import Detection, apply_homography, homography


def find_description_error(
    observations: Sequence[Observation],
    target: Target,
    size: ImageSize,
    rms_px: float = np.inf,
    limits: CharacterisationLimits = USUAL_LIMITS,
) -> str | None:
    """Find what is wrong with a board's description, if another makes the camera fit far better."""
    # size (width, height) px
    flat = {
        description: (_off_plane(observations, other), other)
        for description, other in similar_descriptions(target)
    }
    flattest = min(off_plane_px for off_plane_px, _ in flat.values()) if flat else np.inf
    # A single plane does not determine the ratio of the pitches; a camera in several poses does.
    fits = {
        description: _camera_rms(observations, other, size)
        for description, (off_plane_px, other) in flat.items()
        if off_plane_px <= 1.5 * flattest
    }
    description = min(fits, key=lambda text: fits[text], default="")
    clearly_flatter = flattest < _off_plane(observations, target) / limits.min_description_gain
    fits_far_better = fits and fits[description] < rms_px / limits.min_description_gain < np.inf
    is_likely = fits and fits[description] < limits.max_description_rms_px
    if is_likely and (clearly_flatter or fits_far_better):
        return f"the points found do not form the board described but fit one {description}"
    return None


def _off_plane(observations: Sequence[Observation], target: Target) -> float:
    """Return the RMS distance in px of the camera's points from the best views of a flat board."""
    errors = []
    for observation in observations:
        detection = Detection(observation.ids, observation.camera_px)
        projected = apply_homography(homography(target, detection), target.points()[observation.ids, :2])
        errors.append(projected - observation.camera_px)
    return rms(errors)


def _camera_rms(observations: Sequence[Observation], target: Target, size: ImageSize) -> float:
    """Return the RMS in px of the camera calibrated alone; infinite when the poses do not determine it."""
    points = target.points()
    try:
        rms_px, _, _ = calibrate_by_zhang(
            "camera", [points[o.ids] for o in observations], [o.camera_px for o in observations], size
        )
    except CalibrationError:
        return np.inf
    return rms_px
