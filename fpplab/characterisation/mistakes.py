"""Mistakes that people make with boards and frames, named: what would have fitted is the cause."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.characterisation.descriptions import described_otherwise
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.zhang import Size, rms, zhang
from fpplab.conventions import Floats, phase_steps
from fpplab.errors import CalibrationError
from fpplab.plan import Plan
from fpplab.targets import Target
from fpplab.targets.detection import Detection, apply_homography, homography

BETTER = 4.0
"""How many times better another description must fit to be the right one."""

LIKELY_PX = 3.0
"""A description under which the camera fits worse than this is wrong as well."""

SAMPLE = 7
"""Every so manieth row and column of a frame tells whether the frames are in step."""


def misdescribed(
    observations: Sequence[Observation], target: Target, size: Size, rms_px: float = np.inf
) -> str | None:
    """What is wrong with a board's description, when another makes the camera fit far better.

    size: the camera's. rms_px: how well the camera fits the board as it is described, where it does at all.
    """
    flat = {words: (_off_plane(observations, other), other) for words, other in described_otherwise(target)}
    flattest = min(off for off, _ in flat.values()) if flat else np.inf
    # A plane does not tell one pitch from another; a camera in several poses does.
    fits = {
        words: _camera_rms(observations, other, size)
        for words, (off, other) in flat.items()
        if off <= 1.5 * flattest
    }
    words = min(fits, key=lambda one: fits[one], default="")
    mended = flattest < _off_plane(observations, target) / BETTER
    if fits and fits[words] < LIKELY_PX and (mended or fits[words] < rms_px / BETTER < np.inf):
        return f"the points found do not form the board described but fit one {words}"
    return None


def _off_plane(observations: Sequence[Observation], target: Target) -> float:
    """RMS distance in px of the camera's points from the best perspective views of a flat board."""
    errors = []
    for observation in observations:
        found = Detection(observation.ids, observation.camera_px)
        seen = apply_homography(homography(target, found), target.points()[observation.ids, :2])
        errors.append(seen - observation.camera_px)
    return rms(errors)


def _camera_rms(observations: Sequence[Observation], target: Target, size: Size) -> float:
    """RMS in px of the camera by itself; infinite when the poses do not determine it."""
    points = target.points()
    try:
        found, _, _ = zhang(
            "camera", [points[o.ids] for o in observations], [o.camera_px for o in observations], size
        )
    except CalibrationError:
        return np.inf
    return found


def out_of_step(frames: Sequence[NDArray[Any]], plan: Plan) -> int:
    """By how many frames the pictures lag behind the plan: 0 when they are in step, 1 or -1 when not.

    The sum of a set's frames is the same picture for all sets, and what its sinusoids leave over is
    noise; with a frame of another set among them neither is true. The first and the last set are
    left aside, for their neighbours were not recorded.
    """
    starts = [0, *accumulate(f.steps for f in plan.fringes)]
    sets = [slice(a, b) for a, b in pairwise(starts) if a > 0 and b < len(frames)]
    if not sets:
        return 0
    sample = np.stack([frame[::SAMPLE, ::SAMPLE].astype(np.float64) for frame in frames])
    misfit = {lag: _misfit(sample, [slice(s.start + lag, s.stop + lag) for s in sets]) for lag in (0, 1, -1)}
    best = min(misfit, key=lambda lag: misfit[lag])
    return best if misfit[best] < misfit[0] / BETTER else 0


def _misfit(sample: Floats, sets: Sequence[slice]) -> float:
    """Squares left over by one sinusoid per set and pixel, all with the same offset."""
    means = np.stack([sample[s].mean(axis=0) for s in sets])
    offset = means.mean(axis=0)
    return sum(_left_over(sample[s], offset) for s in sets)


def _left_over(frames: Floats, offset: Floats) -> float:
    shifts = phase_steps(len(frames))
    ripple = frames - offset
    waves = np.stack([np.sin(shifts), np.cos(shifts)])
    amplitudes = np.tensordot(waves, ripple, 1) * (2 / len(frames))
    return float(np.sum((ripple - np.tensordot(waves.T, amplitudes, 1)) ** 2))
