"""A calibration from sessions of a target, and judged by others."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.characterisation import (
    Characterisation,
    Correction,
    DistortionModel,
    Judgement,
    Observation,
    characterise,
    correct,
    finest_periods,
    judge,
    judged_board,
    observe,
)
from fpplab.characterisation.limits import USUAL_LIMITS, CharacterisationLimits
from fpplab.characterisation.observation import board_shift_px
from fpplab.core import config
from fpplab.core.errors import CalibrationError
from fpplab.core.progress import Progress, no_progress
from fpplab.patterns.mosaic import white_levels
from fpplab.phase import decode
from fpplab.pipeline.decoding import fault_in_step, plan_fault
from fpplab.pipeline.marks import correct_by_marks
from fpplab.sessions.origin import calibration_origin
from fpplab.sessions.session import Session
from fpplab.targets import Target


def characterise_sessions(
    sessions: Sequence[Session],
    target: Target,
    progress: Progress = no_progress,
    *,
    level: DistortionModel | Literal["auto"] = "auto",
    refine_board: bool | None = None,
    limits: CharacterisationLimits = USUAL_LIMITS,
) -> Characterisation:
    """Find camera, projector and the pose between them from one session for each pose of a target.

    A pose in which the target is not found, or whose frames are out of step with the plan, is left out and
    named, as long as enough remain.

    Parameters
    ----------
    sessions : sequence of Session
        Complete, of one plan and format.
    target : Target
        The board.
    progress : callable
        Called with the share done, 0 … 1.
    level : DistortionModel or str
        Which distortion is fitted; `auto` takes k3 and gives the errors of all.
    refine_board : bool, optional
        Whether the board's shape is fitted too; by default it is.
    limits : CharacterisationLimits
        By which poses and fit are judged.

    Returns
    -------
    Characterisation
        The calibration, and how well it is known.

    Raises
    ------
    CalibrationError
        Too few poses remain, or the models do not fit.
    """
    require_plan_fits(sessions[0])
    size, lattice = sessions[0].projector()
    observations, left_out = _observe_sessions(sessions, target, lambda share: progress(0.8 * share), limits)
    width, height, _ = sessions[0].format
    result = characterise(
        observations,
        target,
        (width, height),
        size,
        lattice,
        left_out=left_out,
        level=level,
        refine_board=refine_board,
        limits=limits,
    )
    progress(1.0)
    origin, white = calibration_origin(sessions), _board_colours(sessions, observations)
    return replace(result, calibration=replace(result.calibration, origin=origin, white=white))


def _board_colours(
    sessions: Sequence[Session], observations: Sequence[Observation]
) -> tuple[float, float, float] | None:
    """Colours of the ground of the first board, which is taken for white."""
    by_name = {session.path.name: session for session in sessions}
    recording = by_name[observations[0].name].recording(verify=False)
    inside = np.zeros(recording.frames[0].shape, np.uint8)
    cv2.fillConvexPoly(inside, cv2.convexHull(np.rint(observations[0].camera_px).astype(np.int32)), (1,))
    v, u = np.nonzero(inside)
    colours = recording.colours(np.stack([u, v], axis=1).astype(np.int32))
    return None if colours is None else white_levels(colours)


def require_plan_fits(session: Session) -> None:
    """Refuse a plan that does not describe the images, before many poses are decoded by it."""
    if fault := plan_fault(session.recording(verify=False)):
        raise CalibrationError(f"{session.path}: {fault}")


def judge_sessions(
    sessions: Sequence[Session],
    calibration: Calibration,
    source: Path | str,
    progress: Progress = no_progress,
) -> Judgement:
    """Judge a calibration by poses of its board that it was not fitted to, one session each."""
    observations, left_out = _observe_board_of(calibration, sessions, source, progress)
    return judge(calibration, observations, left_out, str(source))


def correct_by_sessions(
    sessions: Sequence[Session],
    calibration: Calibration,
    source: Path | str,
    progress: Progress = no_progress,
) -> Correction:
    """Correct a calibration by poses of its board, one session each, or by a scan of its reference marks."""
    if calibration.marks is not None and len(sessions) == 1:
        try:
            observations, left_out = _observe_board_of(calibration, sessions, source, progress)
        except CalibrationError:
            observations = []
        if not observations:
            return correct_by_marks(sessions[0], calibration, calibration.marks)
    else:
        observations, left_out = _observe_board_of(calibration, sessions, source, progress)
    return correct(calibration, observations, left_out, str(source))


def _observe_board_of(
    calibration: Calibration, sessions: Sequence[Session], source: Path | str, progress: Progress
) -> tuple[list[Observation], dict[str, str]]:
    board = judged_board(calibration, str(source))
    width, height, _ = sessions[0].format
    calibration.check_camera((width, height), sessions[0].path)
    calibration.check_projector(*sessions[0].projector(), sessions[0].path)
    target = config.validate(board.target, Target, f"{source}: board.target")
    return _observe_sessions(sessions, target, progress)


def _observe_sessions(
    sessions: Sequence[Session],
    target: Target,
    progress: Progress,
    limits: CharacterisationLimits = USUAL_LIMITS,
) -> tuple[list[Observation], dict[str, str]]:
    periods = finest_periods(sessions[0].plan, sessions[0].projector()[0])
    observations: list[Observation] = []
    left_out: dict[str, str] = {}
    for k, session in enumerate(sessions):
        try:
            observations.append(observe_session(session, target, periods, limits))
        except CalibrationError as error:
            left_out[session.path.name] = str(error)
        progress((k + 1) / len(sessions))
    return observations, left_out


def observe_session(
    session: Session,
    target: Target,
    periods: tuple[float, float],
    limits: CharacterisationLimits = USUAL_LIMITS,
) -> Observation:
    """Find a board in one pose, and its points in camera and projector."""
    name, recording = session.path.name, session.recording()
    if fault := fault_in_step(recording):
        raise CalibrationError(f"{name}: {fault}; take this pose again")
    observed = observe(name, recording.mean_image(), decode(recording), target, periods, limits)
    shift_px = board_shift_px(recording.mean_image(0), recording.mean_image(-1), observed.camera_px)
    return replace(observed, board_shift_px=shift_px)
