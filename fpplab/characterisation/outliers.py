"""Outliers: poses in which something moved, and points that were located wrongly."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fpplab.characterisation.limits import USUAL_LIMITS, CharacterisationLimits
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import Solution
from fpplab.characterisation.result import Rejected
from fpplab.characterisation.zhang import rms_of_poses
from fpplab.core.conventions import Floats
from fpplab.core.robust import robust_spread


def find_moved_pose(
    observations: Sequence[Observation],
    solution: Solution,
    least_px: float,
    limits: CharacterisationLimits = USUAL_LIMITS,
) -> int | None:
    """Find the pose that fits so much worse than the others that something moved while it was captured."""
    rms = rms_of_poses(observations, solution)
    worst = int(np.argmax(rms))
    return worst if rms[worst] > max(limits.max_pose_rms_ratio * float(np.median(rms)), least_px) else None


def rejectable_points(
    observations: Sequence[Observation], limits: CharacterisationLimits = USUAL_LIMITS
) -> list[int]:
    return [int(limits.max_rejected_share * len(o.ids)) for o in observations]


def reject_points(
    observations: Sequence[Observation],
    solution: Solution,
    rejectable: list[int],
    limits: CharacterisationLimits = USUAL_LIMITS,
) -> tuple[list[Observation], list[Rejected]]:
    # The threshold is relative to each device's own robust standard deviation over all poses.
    residuals = [
        [np.nan_to_num(r) for r in solution.residuals(i, o)] for i, o in enumerate(observations)
    ]  # NaN of a coordinate that was not coded
    spreads = [_spread([pair[device] for pair in residuals]) for device in (0, 1)]
    max_px = np.maximum(limits.max_residual_sigmas * np.array(spreads), limits.min_rejected_px)
    kept, rejected = [], []
    for index, (observation, pair) in enumerate(zip(observations, residuals, strict=True)):
        lengths = np.stack([np.linalg.norm(r, axis=1) for r in pair])
        excess = lengths / max_px[:, None]
        order = np.argsort(-excess.max(axis=0), kind="stable")[: rejectable[index]]
        wrong = order[excess.max(axis=0)[order] > 1]
        rejectable[index] -= len(wrong)
        rejected += [
            _rejection_of_point(observation, row, int(np.argmax(excess[:, row])), lengths, spreads)
            for row in wrong
        ]
        kept.append(_without(observation, wrong))
    return kept, rejected


def _spread(residuals: Sequence[Floats]) -> float:
    """Return the robust standard deviation of a coordinate in px."""
    return robust_spread(np.concatenate(list(residuals)), 0.0)


def _rejection_of_point(
    observation: Observation, row: int, device: int, lengths: Floats, spreads: Sequence[float]
) -> Rejected:
    name, point, length = ("camera", "projector")[device], int(observation.ids[row]), lengths[device, row]
    why = (
        f"point {point} lies {length:.2f} px from where the {name} should see it, "
        f"the others {spreads[device]:.2f} px (one standard deviation)"
    )
    return Rejected(observation.name, point, name, float(length), why)


def _without(observation: Observation, rows: NDArray[np.intp]) -> Observation:
    if len(rows) == 0:
        return observation
    return replace(
        observation,
        ids=np.delete(observation.ids, rows),
        camera_px=np.delete(observation.camera_px, rows, axis=0),
        projector_px=np.delete(observation.projector_px, rows, axis=0),
    )
