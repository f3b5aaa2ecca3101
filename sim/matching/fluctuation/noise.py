"""Noise of the bench's sensor, estimated from its frames for the twin: photon transfer.

The sensor's noise is what the phase fit leaves of the frames beyond harmonics and flicker
(`fpplab.phase.error_model`), so that nothing which the twin lacks is taken for noise. It is estimated equally
from frames of the bench and of the twin, and the twin's is scaled.

Source: Janesick, Photon Transfer, 2007.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from fpplab.core.conventions import Floats, Image
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.phase.code_decoding import decode_codes
from fpplab.phase.coded_axes import sets_of_axis
from fpplab.phase.common_errors import beyond_fringe
from fpplab.phase.error_model import error_model_of
from fpplab.phase.noise import QUANTISATION, NoiseModel
from sim.matching.loss import board_mask
from sim.matching.reference import LevelStack, Reference
from sim.parameters import TwinParameters
from sim.twin import Twin


@dataclass(frozen=True)
class NoiseLimits:
    """How the noise of bench and twin is compared."""

    poses: int = 4  # whose frames are compared, at most: each has all levels (chosen, for speed)
    max_chance: float = 0.01  # with which equal noise changes the twin (chosen)
    rounds: int = 2  # comparisons, each with the twin that the one before gave (chosen)
    probe_e: float = 5.0  # electrons; read noise whose effect on the levels is tried first (chosen)
    probe_factor: float = 4.0  # by which it grows until it shows (chosen)
    max_probe_e: float = 1e5  # electrons; where that ends (chosen)
    fine_px: float = 1.5  # width that divides residuals into fine and coarse (chosen)
    levels: int = 3  # classes of brightness (chosen)


LIMITS = NoiseLimits()


def match_noise(reference: Reference, twin: Twin, poses: Sequence[int]) -> TwinParameters:
    """Give the twin the noise of the reference, estimated in the same way from frames of both."""
    # Read noise is changed only where the two differ significantly at black. Rounding makes the estimates
    # nonlinear, so they are compared again with the twin as it was found.
    real = [_noise_of(reference, pose, reference.recorded(pose)) for pose in poses]
    levels = [_bright_level(reference, pose) for pose in poses]
    for _ in range(LIMITS.rounds):
        changed = _sensor_noise(reference, twin, poses, real, levels)
        if changed is twin.parameters:
            break
        twin = twin.with_parameters(changed)
    return twin.parameters


def _sensor_noise(
    reference: Reference,
    twin: Twin,
    poses: Sequence[int],
    real: Sequence[NoiseModel],
    levels: Sequence[float],
) -> TwinParameters:
    """Change full well and read noise: variances at black and at the bright levels become the bench's."""
    now = twin.parameters
    own = [_twin_noise(reference, twin, pose) for pose in poses]
    pairs = list(zip(real, own, strict=True))
    at_black = np.array([a.constant - b.constant for a, b in pairs])
    if not _is_mean_significant(at_black):
        shot = np.array(
            [(_above_rounding(a, x), _above_rounding(b, x)) for (a, b), x in zip(pairs, levels, strict=True)]
        )
    else:
        changed = _read_noise(reference, twin, poses[:2], own, float(at_black.mean()))
        now = replace(now, read_noise_e=changed)
        shot = np.array([(a.per_level, b.per_level) for a, b in pairs])
    of_bench, of_twin = shot.sum(axis=0)
    if min(of_bench, of_twin) <= 0 or not _is_mean_significant(shot[:, 0] - shot[:, 1]):
        return now
    # Electrons per level: the read noise in levels is not to change with them.
    ratio = float(of_twin / of_bench)
    return replace(now, full_well_e=now.full_well_e * ratio, read_noise_e=now.read_noise_e * ratio)


def _bright_level(reference: Reference, pose: int) -> float:
    """Mean of what is brighter than the mean, in 8-bit grey levels: there shot noise outweighs rounding."""
    frames = reference.frames(pose, reference.one_of_each_set)
    return float(frames[frames > frames.mean()].mean()) / reference.full_scale * 255.0


def _is_mean_significant(differences: Floats) -> bool:
    """Whether the mean of what several poses say differs from 0 by more than their scatter explains."""
    count = len(differences)
    if count < 2:
        return False
    # Of few poses the scatter itself is hardly known: by Student's distribution.
    reach = stdtrit(count - 1, 1.0 - 0.5 * LIMITS.max_chance)
    return bool(abs(differences.mean()) > reach * differences.std(ddof=1) / np.sqrt(count))


def _above_rounding(noise: NoiseModel, level: float) -> float:
    return float(noise.variance(level)) - QUANTISATION * noise.step**2


def _read_noise(
    reference: Reference, twin: Twin, poses: Sequence[int], twin_noise: Sequence[NoiseModel], excess: float
) -> float:
    """Read noise that adds `excess` to the variance at black, by what a probe adds to it."""
    now = twin.parameters
    before = float(np.mean([model.constant for model in twin_noise]))
    probe_e, added = max(LIMITS.probe_e, now.read_noise_e), 0.0
    while added < 0.5 * abs(excess) and probe_e < LIMITS.max_probe_e:
        probe_e *= LIMITS.probe_factor
        noisier = twin.with_parameters(replace(now, read_noise_e=probe_e))
        added = float(np.mean([_twin_noise(reference, noisier, pose).constant for pose in poses])) - before
    if added <= 0:
        return now.read_noise_e
    per_square = added / (probe_e**2 - now.read_noise_e**2)
    return float(np.sqrt(max(now.read_noise_e**2 + excess / per_square, 0.0)))


def _twin_noise(reference: Reference, twin: Twin, pose: int) -> NoiseModel:
    return _noise_of(reference, pose, twin.frames(pose, reference.patterns, reference.settings))


def _noise_of(reference: Reference, pose: int, frames: Sequence[Image]) -> NoiseModel:
    recording = reference.recording(pose, frames)
    if fringes := recording.fringe_part:
        return error_model_of(fringes).noise
    axis = recording.plan.axes[0]
    return decode_codes(recording, axis, sets_of_axis(recording.plan, axis, with_fringes=False)).noise


def noise_misfit(reference: Reference, twin: Twin, poses: Sequence[int]) -> Floats:
    """Compute how far the twin's noise is from the reference's in each pose, by variance and by spectrum."""
    # Compared is what the phase fit leaves of the finest fringes over the board, in `levels` classes of
    # brightness, divided into structure finer and coarser than `fine_px`: the sensor's noise is fine,
    # vibration is as coarse as edges and fringes are.
    # Codes leave no such rest: their misfit has the twin's faults too, by which no step is judged.
    index, plan = reference.finest_sets[0], reference.plan
    fringe, images = plan.sets[index], range(*plan.set_starts[index : index + 2])
    if not isinstance(fringe, FringeSet) or len(images) < 4:
        return np.zeros(len(poses))
    shift = fringe.phase_shifts()
    off = []
    for pose in poses:
        now = twin.parameters
        board = board_mask(now.calibration.camera, now.poses[pose], reference.target)
        real = reference.frames(pose, images)
        own = np.stack(twin.frames(pose, reference.shown(images), reference.settings)).astype(np.float32)
        edges = np.quantile(real.mean(axis=0)[board], np.linspace(0, 1, LIMITS.levels + 1)[1:-1])
        classes = np.where(board, np.digitize(real.mean(axis=0), edges), -1)
        off.append(np.log(_spreads(real, shift, classes) / _spreads(own, shift, classes)))
    return np.asarray(np.square(off).mean(axis=(1, 2)))


def _spreads(frames: LevelStack, shift: Floats, classes: NDArray[np.int64]) -> Floats:
    """Standard deviations (LIMITS.levels, 2) of what the phase fit leaves, fine and coarse."""
    rest = np.einsum("mn,nvu->mvu", beyond_fringe(shift), frames)
    coarse = np.stack([cv2.GaussianBlur(frame.astype(np.float32), (0, 0), LIMITS.fine_px) for frame in rest])
    parts = (rest - coarse, coarse)
    freedom = len(shift) / (len(shift) - 3)
    return np.array(
        [
            [max(float(np.sqrt(freedom * np.mean(part[:, classes == k] ** 2))), 1e-3) for part in parts]
            for k in range(LIMITS.levels)
        ]
    )
