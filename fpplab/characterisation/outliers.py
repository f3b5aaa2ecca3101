"""Outliers: poses in which something moved, and points that were located wrongly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import Solution
from fpplab.characterisation.result import Rejected
from fpplab.characterisation.zhang import rms_of_poses
from fpplab.core.conventions import Floats
from fpplab.core.robust import robust_spread

MOVED_POSE = 4.0
"""A pose whose RMS is this many times the median is excluded: the board, the rig or the focus changed."""

OUTLIER = 5.0
"""Standard deviations beyond which a point is rejected; noise alone exceeds them once in 270 000."""

LEAST_ERROR_PX = 0.02
"""Least error in px of a point that is rejected, however small the others' scatter."""

MOST_REJECTED = 0.1
"""Greatest share of a pose's points that may be rejected; if more are wrong, the pose itself is."""


def find_moved_pose(observations: Sequence[Observation], solution: Solution, least_px: float) -> int | None:
    """Find the pose that fits so much worse than the others that something moved while it was captured."""
    rms = rms_of_poses(observations, solution)
    worst = int(np.argmax(rms))
    return worst if rms[worst] > max(MOVED_POSE * float(np.median(rms)), least_px) else None


def rejection_limits(observations: Sequence[Observation]) -> list[int]:
    """Compute how many points of each pose may be rejected."""
    return [int(MOST_REJECTED * len(o.ids)) for o in observations]


def reject_points(
    observations: Sequence[Observation], solution: Solution, left: list[int]
) -> tuple[list[Observation], list[Rejected]]:
    """Reject points that lie wrong in either device.

    The threshold is relative to each device's own robust standard deviation over all poses.
    """
    residuals = [solution.residuals(i, o) for i, o in enumerate(observations)]
    spreads = [_spread([pair[device] for pair in residuals]) for device in (0, 1)]
    limits = np.maximum(OUTLIER * np.array(spreads), LEAST_ERROR_PX)
    kept, rejected = [], []
    for index, (observation, pair) in enumerate(zip(observations, residuals, strict=True)):
        lengths = np.stack([np.linalg.norm(r, axis=1) for r in pair])
        excess = lengths / limits[:, None]
        order = np.argsort(-excess.max(axis=0), kind="stable")[: left[index]]
        wrong = order[excess.max(axis=0)[order] > 1]
        left[index] -= len(wrong)
        rejected += [
            _rejected(observation, row, int(np.argmax(excess[:, row])), lengths, spreads) for row in wrong
        ]
        kept.append(_without(observation, wrong))
    return kept, rejected


def _spread(residuals: Sequence[Floats]) -> float:
    """Return the robust standard deviation of a coordinate in px."""
    return robust_spread(np.concatenate(list(residuals)), 0.0)


def _rejected(
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
