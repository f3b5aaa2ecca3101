"""Evaluation of a twin: expected images are compared with the reference, noisy frames characterised."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import partial

import numpy as np

from fpplab.characterisation import Characterisation, Observation, characterise, finest_periods, observe
from fpplab.characterisation.pose_effects import FUNCTIONS
from fpplab.core.errors import CalibrationError
from fpplab.core.progress import Progress, no_progress
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from sim.effects.step import ReprojectionErrors
from sim.matching.loss import Loss, Similarity, Weights, board_mask, ssim
from sim.matching.passes import twin_recording
from sim.matching.reference import LevelStack, Reference
from sim.twin import Twin


@dataclass(frozen=True, eq=False)
class TwinEvaluation:
    """How well a twin agrees with the reference."""

    loss: Loss  # the loss with its parts
    characterisation: Characterisation | None  # of the twin's own frames

    def by_pose_name(self, reference: Reference) -> dict[str, dict[str, float]]:
        """Give the figures of every pose; the images of all have been compared."""
        names = [session.path.name for session in reference.sessions]
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
            of_reference = _rms_of_poses(reference.characterisation)
            of_twin = _rms_of_poses(self.characterisation)
            for name, error in of_twin.items():
                figures[name]["epsilon_d_px"] = of_reference[name] - error
        return figures


def _rms_of_poses(characterisation: Characterisation) -> dict[str, float]:
    """Joint RMS reprojection error in px by name of pose."""
    return {
        name: float(np.hypot(of["camera"], of["projector"]) / np.sqrt(2.0))
        for name, of in characterisation.pose_rms_px.items()
    }


def evaluate(
    reference: Reference,
    twin: Twin,
    weights: Weights,
    known_twin_rms_px: float | None = None,
    poses: Sequence[int] | None = None,
    characterised: Sequence[int] | None = None,
    progress: Progress = no_progress,
) -> TwinEvaluation:
    """Compare the twin's expected images with the reference, pose by pose, all unless some are named."""
    # characterised: the poses whose noisy frames characterise the twin, all that are compared for None
    # They have no noise: two realisations of it never agree, and noise is judged by its variance.
    chosen: Sequence[int] = range(len(twin.parameters.poses)) if poses is None else sorted(poses)
    noisy = set(chosen if characterised is None else characterised) if known_twin_rms_px is None else set()
    pairs: list[tuple[float, float]] = []
    observed: dict[int, Future[Observation]] = {}
    with ThreadPoolExecutor(1) as pool:  # observes a pose while the next one's frames are simulated
        for done, pose in enumerate(chosen, 1):
            if pose in noisy:  # first, since its light has what the images need
                recording = _twin_recording(reference, twin, pose)
                wait(observed.values())  # so that no more than two poses' frames are held
                observed[pose] = pool.submit(_observe_board, reference, pose, recording)
            pairs += pose_similarity(reference, twin, pose)
            progress(done / len(chosen))
    similarity = Similarity(*(np.array(future) for future in zip(*pairs, strict=True)))
    characterisation = None
    if known_twin_rms_px is None:
        # What counts is the twin's error and its calibration, not how sure they are.
        results = ((pose, future.result) for pose, future in observed.items())
        characterisation = _characterise_observed(reference, results, validate=False)
    own = characterisation.calibration.rms_px["joint"] if characterisation else known_twin_rms_px
    assert own is not None
    return TwinEvaluation(Loss(weights, reference.reference_rms_px, own, similarity), characterisation)


def characterise_twin(reference: Reference, twin: Twin, poses: Sequence[int]) -> Characterisation:
    """Characterise the twin by its own frames of some poses."""

    def observed(pose: int) -> Observation:
        return _observe_board(reference, pose, _twin_recording(reference, twin, pose))

    results = ((pose, partial(observed, pose)) for pose in poses)
    return _characterise_observed(reference, results, validate=True)


def reprojection_errors(characterisation: Characterisation) -> ReprojectionErrors:
    """Give the errors of a characterisation, with the uncertainty that so many points and poses leave."""
    rms_px, poses = characterisation.calibration.rms_px, len(characterisation.poses)
    left_out_px = characterisation.leave_one_out_px or rms_px  # which few poses do not have
    px2 = np.square(
        [[figures[name] for name in ("camera", "projector")] for figures in (rms_px, left_out_px)]
    )
    # Two coordinates of each point; of the poses two of each smooth function that a pose's points share.
    free = np.array([[2.0 * characterisation.points], [2.0 * FUNCTIONS * poses]])
    return ReprojectionErrors(px2, px2 * np.sqrt(2.0 / free))


def pose_similarity(reference: Reference, twin: Twin, pose: int) -> list[tuple[float, float]]:
    """Compare the first image of every fringe set in one pose with the twin's, which has no noise."""
    now, images = twin.parameters, reference.one_of_each_set
    expected = twin.expected(pose, reference.shown(images), reference.settings)
    board = board_mask(now.calibration.camera, now.poses[pose], reference.target)

    def compare(real: LevelStack, own: LevelStack) -> tuple[float, float]:
        return ssim(real, own, reference.full_scale, board)

    both = (
        reference.evened(levels, now.black_level) for levels in (reference.frames(pose, images), expected)
    )
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(compare, *both))


def _twin_recording(reference: Reference, twin: Twin, pose: int) -> Recording:
    session = reference.sessions[pose]
    name = f"the twin's {session.path.name}"
    return twin_recording(session, reference.patterns, partial(twin.frames, pose), name)


def _observe_board(reference: Reference, pose: int, recording: Recording) -> Observation:
    """Observe the board in the twin's frames of a pose. Raises `CalibrationError` where it is not found."""
    plan, (size, _) = reference.plan, reference.projector
    name = reference.sessions[pose].path.name
    decoded, image = decode(recording), recording.mean_image()
    return observe(name, image, decoded, reference.target, finest_periods(plan, size))


def _characterise_observed(
    reference: Reference, results: Iterable[tuple[int, Callable[[], Observation]]], validate: bool
) -> Characterisation:
    """Characterise the twin by poses, without those in which the board is not found."""
    observations: list[Observation] = []
    left_out: dict[str, str] = {}
    for pose, observed in results:
        try:
            observations.append(observed())
        except CalibrationError as error:
            left_out[reference.sessions[pose].path.name] = str(error)
    bench, (size, lattice) = reference.characterisation, reference.projector
    width, height, _ = reference.sessions[0].format
    try:
        return characterise(
            observations,
            reference.target,
            (width, height),
            size,
            lattice,
            left_out=left_out,
            level=bench.level,
            refine_board=bench.drawn is not None,
            validate=validate,
        )
    except CalibrationError as error:
        raise CalibrationError(f"the twin's own frames cannot be characterised: {error}") from error
