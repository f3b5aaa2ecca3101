"""A twin judged as the bench is: its own noisy frames, compared image by image and characterised alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from fpplab.characterisation import Characterisation, Observation, characterise, finest_periods, observe
from fpplab.core.conventions import Image
from fpplab.core.errors import CalibrationError
from fpplab.core.progress import Progress, no_progress
from fpplab.matching.loss import Loss, Similarity, Weights, board_mask, ssim
from fpplab.matching.reference import Reference
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.simulation.matchable import Twin


@dataclass(frozen=True, eq=False)
class TwinEvaluation:
    """The loss, and the characterisation of the twin's own frames where it was made."""

    loss: Loss
    characterisation: Characterisation | None

    def of_poses(self, bench: Reference) -> dict[str, dict[str, float]]:
        """By name of pose: its images' mean SSIM, and the bench's less the twin's RMS reprojection error in
        px where the board was found in the twin's frames.
        """
        names = [session.path.name for session in bench.sessions]
        similar = self.loss.similarity
        figures = {
            name: {"ssim": float(whole), "ssim_board": float(board)}
            for name, whole, board in zip(
                names,
                similar.whole.reshape(len(names), -1).mean(axis=1),
                similar.board.reshape(len(names), -1).mean(axis=1),
                strict=True,
            )
        }
        if self.characterisation:
            there, here = _rms_of_poses(bench.characterisation), _rms_of_poses(self.characterisation)
            for name, error in here.items():
                figures[name]["epsilon_d_px"] = there[name] - error
        return figures


def _rms_of_poses(found: Characterisation) -> dict[str, float]:
    """Joint RMS reprojection error in px by name of pose."""
    return {
        name: float(np.hypot(of["camera"], of["projector"]) / np.sqrt(2.0))
        for name, of in found.pose_rms_px.items()
    }


def evaluate(
    bench: Reference,
    twin: Twin,
    weights: Weights,
    epsilon_v: float | None = None,
    images: Sequence[int] | None = None,
    progress: Progress = no_progress,
) -> TwinEvaluation:
    """Compare the twin's frames with the bench's, pose by pose.

    epsilon_v: the twin's RMS in px where it is known; otherwise all its frames are taken and characterised.
    images: that are compared, one of each set by default. Raises `CalibrationError` when the twin's own
    frames cannot be characterised.
    """
    compared = bench.one_of_each_set if images is None else tuple(images)
    every = tuple(range(len(bench.patterns)))
    taken = every if epsilon_v is None else compared
    poses = len(twin.parameters.poses)
    pairs: list[tuple[float, float]] = []
    seen: list[Observation] = []
    left_out: dict[str, str] = {}
    with ThreadPoolExecutor(2) as pool:
        for pose in range(poses):
            frames = dict(zip(taken, twin.frames(pose, bench.shown(taken), bench.settings), strict=True))
            pairs += pool.map(_Compared(bench, twin, pose, frames), compared)
            if epsilon_v is None:
                try:
                    seen.append(_observed(bench, pose, [frames[i] for i in every]))
                except CalibrationError as error:
                    left_out[bench.sessions[pose].path.name] = str(error)
            progress((pose + 1) / poses)
    similarity = Similarity(*(np.array(one) for one in zip(*pairs, strict=True)))
    found = _characterised(bench, seen, left_out) if epsilon_v is None else None
    own = found.calibration.rms_px["joint"] if found else epsilon_v
    assert own is not None
    return TwinEvaluation(Loss(weights, bench.epsilon_r, own, similarity), found)


class _Compared:
    """The SSIM of one image, for a pool of threads."""

    def __init__(self, bench: Reference, twin: Twin, pose: int, frames: dict[int, Image]) -> None:
        now = twin.parameters
        self._board = board_mask(now.calibration.camera, now.poses[pose], bench.target)
        self._bench, self._pose, self._frames = bench, pose, frames

    def __call__(self, index: int) -> tuple[float, float]:
        real = self._bench.frames(self._pose, [index])[0]
        return ssim(real, self._frames[index], self._bench.full_scale, self._board)


def _observed(bench: Reference, pose: int, frames: Sequence[Image]) -> Observation:
    """The board in the twin's frames of a pose. Raises `CalibrationError` where it is not found."""
    plan, (size, _) = bench.plan, bench.projector
    name = bench.sessions[pose].path.name
    recording = Recording(frames, plan, size, bench.settings.bits, f"the twin's {name}")
    decoded = decode(recording)
    return observe(name, recording.mean_image(), decoded, bench.target, finest_periods(plan, size))


def _characterised(
    bench: Reference, seen: Sequence[Observation], left_out: Mapping[str, str]
) -> Characterisation:
    found, (size, lattice) = bench.characterisation, bench.projector
    width, height, _ = bench.sessions[0].format
    try:
        return characterise(
            seen,
            bench.target,
            (width, height),
            size,
            lattice,
            left_out=left_out,
            level=found.level,
            refine_board=found.drawn is not None,
        )
    except CalibrationError as error:
        raise CalibrationError(f"the twin's own frames cannot be characterised: {error}") from error
