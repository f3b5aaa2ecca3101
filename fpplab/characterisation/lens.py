"""Whether the camera's lens kept its scale from pose to pose of a characterisation."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from fpplab.characterisation.limits import USUAL_LIMITS, CharacterisationLimits
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import ErrorSizes, Solution
from fpplab.core.conventions import Floats


def scales_of_poses(
    observations: Sequence[Observation], solution: Solution, sizes: ErrorSizes
) -> tuple[Floats, Floats]:
    """Estimate by how much the camera's image of each pose is larger than the calibration says."""
    # The projector's coordinates show where the board is, so that its distance does not explain another
    # scale.
    # returns scales (M,), sigmas (M,)
    estimates = [
        _best_scale_of_pose(k, observation, solution, sizes) for k, observation in enumerate(observations)
    ]
    scales, sigmas = np.array(estimates).T
    return scales, sigmas


def scale_scatter(scales: Floats, sigmas: Floats) -> tuple[float, float]:
    weights = 1.0 / sigmas**2
    deviations = scales - float((weights * scales).sum() / weights.sum())
    freedom = len(scales) - 1
    beyond = float((deviations**2 - sigmas**2).mean()) * len(scales) / freedom
    return float(np.sqrt(max(beyond, 0.0))), float(chi2.sf((weights * deviations**2).sum(), freedom))


def has_focus_breathing(
    scales: Floats, sigmas: Floats, limits: CharacterisationLimits = USUAL_LIMITS
) -> bool:
    """Tell whether the scale differs between poses, even without the one in which it differs most."""
    # A board that moved in one pose looks like another scale there.
    if len(scales) < limits.min_focus_poses:
        return False
    outlier = int(np.argmax(np.abs(scales - np.median(scales)) / sigmas))
    scatter, chance = scale_scatter(np.delete(scales, outlier), np.delete(sigmas, outlier))
    return chance < limits.max_chance and scatter > limits.max_focus_breathing


def _best_scale_of_pose(
    index: int, observation: Observation, solution: Solution, sizes: ErrorSizes
) -> tuple[float, float]:
    """The scale that fits one pose best together with its place, and its uncertainty."""
    step = np.array([1e-5] * 3 + [1e-3] * 3)

    def whitened(pose: Floats) -> Floats:
        own = solution.at_pose(pose, solution.ages[index : index + 1]).residuals(0, observation)
        carried = np.hypot(sizes.projector_px, solution.carried * sizes.camera_px)
        return np.concatenate([(own[0] / sizes.camera_px).ravel(), (own[1] / carried).ravel()])

    pose = solution.poses[index]
    here = whitened(pose)
    moved = [(whitened(pose + d) - here) / d.sum() for d in np.diag(step)]
    radial = (observation.camera_px - solution.camera[2:4]) / sizes.camera_px
    larger = np.concatenate([radial.ravel(), np.zeros(2 * len(radial))])
    normal = np.stack([*moved, larger])
    inverse = np.linalg.inv(normal @ normal.T)
    return float(-(inverse @ normal @ here)[-1]), float(np.sqrt(inverse[-1, -1]))
