"""What does not belong: poses in which something moved, and points that were found in a wrong place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fpplab.characterisation.bundle import Solution
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.result import Rejected
from fpplab.characterisation.zhang import rms_of_poses
from fpplab.core.conventions import Floats

ODD_POSE = 4.0
"""A pose this many times worse than the median of all is not of the same board, rig and focus."""

OUTLIER = 5.0
"""A point this many standard deviations from where it should be: noise alone does it once in 270 000."""

LEAST_ERROR_PX = 0.02
"""Nearer points are never outliers, however small the spread of the others."""

MOST_REJECTED = 0.1
"""Greatest share of a pose's points that may be rejected; if more are wrong the pose is, not the points."""


def odd_pose(observations: Sequence[Observation], solution: Solution, least_px: float) -> int | None:
    """The pose that fits so much worse than the rest that something moved while it was captured."""
    rms = rms_of_poses(observations, solution)
    worst = int(np.argmax(rms))
    return worst if rms[worst] > max(ODD_POSE * float(np.median(rms)), least_px) else None


def budget(observations: Sequence[Observation]) -> list[int]:
    """How many points of each pose may be rejected."""
    return [int(MOST_REJECTED * len(o.ids)) for o in observations]


def reject(
    observations: Sequence[Observation], solution: Solution, left: list[int]
) -> tuple[list[Observation], list[Rejected]]:
    """The observations without the points that lie wrong in either device, and these with a reason each.

    left: how many points of each pose may still be rejected; the worst go first. It is reduced.
    The measure is each device's own spread: the median of its residuals' size, over all poses.
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
    """Robust standard deviation of a coordinate in px."""
    return 1.4826 * float(np.median(np.abs(np.concatenate(list(residuals)))))


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
