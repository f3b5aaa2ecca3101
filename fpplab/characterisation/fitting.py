"""Characterisation of a camera and a projector from poses of a board.

Zhang's method for each device, then the pose between them, then everything together
(`fpplab.characterisation.bundle`), without what does not belong, and judged by poses that were not fitted.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.characterisation import coverage, outliers
from fpplab.characterisation.board_diagnosis import misdescribed
from fpplab.characterisation.bundle import (
    DistortionModel,
    Model,
    Solution,
    adjust_bundle,
    fit_pose,
    uncertainty,
)
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.result import Characterisation, ModelTrial, Rejected
from fpplab.characterisation.zhang import ImageSize, apart, matrix_of, refuse_mirrors, rms, stereo, transform
from fpplab.core.conventions import Floats, Lattice
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import Pinhole
from fpplab.targets import Target

LEAST_POSES = 3
"""Zhang's method needs this many tilted poses when nothing of the device is known."""

SIMPLEST = next(iter(DistortionModel))
"""More distortion needs evidence: poses that it predicts better."""

LEAST_GAIN = 0.02
"""Share of the mean square error in poses left out by which more distortion must lessen it."""

WORST_FOCAL = 0.03
"""Greatest relative uncertainty of a focal length that deserves the name of a result."""

SUSPECT_PX = 1.0
"""A camera that fits worse than this by itself may be looking at another board than described."""

BOARD_SIGMA_MM = 0.1
"""How far a printed board's points lie from where they are drawn, where its target file does not say."""

UNJUDGED = (
    f"{LEAST_POSES} poses leave none to judge the distortion by, so {SIMPLEST} was taken, the simplest "
    "model; take more poses, or name the model"
)
"""What is said when there is nothing to choose the level by."""

Residuals = tuple[Floats, Floats]
"""Of one pose, model minus observation in px, for the camera and the projector, (K, 2) each."""


def characterise(
    observations: Sequence[Observation],
    target: Target,
    camera_size: ImageSize,
    projector_size: ImageSize,
    lattice: Lattice = Lattice.SQUARE,
    *,
    left_out: Mapping[str, str] | None = None,
    level: DistortionModel | Literal["auto"] = "auto",
    refine_board: bool | None = None,
) -> Characterisation:
    """Both devices and the pose between them, from what `observe` made of each pose.

    camera_size, projector_size: (width, height) in px. left_out: the poses that could not be
    observed, with a sentence each that names the pose and says why. level: of the distortion; `auto`
    takes the one with the smallest error in poses left out, or the simplest that is as good as that
    within the standard error of the difference over the poses, or within `LEAST_GAIN`. `LEAST_POSES` poses
    leave none to judge by, and it takes the simplest of all, with a warning.
    refine_board: whether the board's own shape is fitted too, held by `target.tolerance_mm`, or
    `BOARD_SIGMA_MM` without it; None does so when the target has a tolerance.

    Raises `CalibrationError` when fewer than `LEAST_POSES` poses can be used, naming why each of
    the others cannot, when the poses do not determine the devices, and when the board is not the one
    described or one of the devices sees it mirrored.
    """
    missing = dict(left_out or {})
    most = DistortionModel.K3 if level == "auto" else level
    model = Model(most, target.points(), _board_sigma(target, refine_board))
    kept, start, apart_px = _settled(observations, target, model, (camera_size, projector_size), missing)
    kept, start, rejected = _without_outliers(kept, start, model)
    # With few terms the distortion would stand in for tilts that are missing, so all are free here.
    _determined(start, uncertainty(kept, start, model).sigma)
    few = level == "auto" and len(kept) <= LEAST_POSES
    tried = [_tried(kept, start, model, one) for one in _candidates(level, few)]
    trial, solution, _ = tried[_chosen(tried)]
    known = uncertainty(kept, solution, replace(model, level=trial.level))
    cameras, projectors = zip(*(solution.residuals(i, o) for i, o in enumerate(kept)), strict=True)
    calibration = Calibration(
        Pinhole(camera_size, matrix_of(solution.camera), solution.camera[4:]),
        Pinhole(projector_size, matrix_of(solution.projector), solution.projector[4:], lattice),
        transform(solution.T_projector_camera),
        trial.fitted_px,
        known,
    )
    poses = tuple(transform(p) for p in solution.poses)
    return Characterisation(
        calibration,
        tuple(kept),
        poses,
        cameras,
        projectors,
        apart_px,
        trial.held_out_px,
        solution.board,
        missing,
        known.sigma,
        trial.level,
        tuple(t for t, _, _ in tried),
        tuple(rejected),
        (UNJUDGED,) * few + coverage.warnings(kept, poses, calibration, solution.board),
        None if model.board_sigma_mm is None else model.drawn,
    )


def _board_sigma(target: Target, refine: bool | None) -> float | None:
    if refine is None:
        return target.tolerance_mm
    return (target.tolerance_mm or BOARD_SIGMA_MM) if refine else None


def _settled(
    observations: Sequence[Observation], target: Target, model: Model, sizes: tuple[ImageSize, ImageSize],
    missing: dict[str, str],
) -> tuple[list[Observation], Solution, dict[str, float]]:  # fmt: skip
    """The poses that belong together, their joint fit, and the RMS of the steps before it.

    What does not belong is added to `missing`.
    """
    kept = list(observations)
    while True:
        _enough(kept, missing)
        start, apart_px = _started(kept, target, sizes)
        odd = outliers.odd_pose(kept, start, 5.0)
        if odd is None:
            pair, apart_px["stereo"] = stereo(kept, start, sizes[0])
            start = adjust_bundle(kept, replace(start, T_projector_camera=pair), model)
            odd = outliers.odd_pose(kept, start, 1.0)
        if odd is None:
            return kept, start, apart_px
        missing[kept[odd].name] = (
            f"{kept[odd].name}: fits {outliers.ODD_POSE:g} times worse than the other poses; "
            "the board or the rig moved during the capture"
        )
        del kept[odd]


def _started(
    observations: Sequence[Observation], target: Target, sizes: tuple[ImageSize, ImageSize]
) -> tuple[Solution, dict[str, float]]:
    """Both devices apart; a poor fit that another description of the board would mend is refused."""
    try:
        start, lit, apart_px = apart(observations, target.points(), *sizes)
    except CalibrationError as error:
        raise CalibrationError(misdescribed(observations, target, sizes[0]) or str(error)) from error
    if apart_px["camera"] > SUSPECT_PX:
        mistake = misdescribed(observations, target, sizes[0], apart_px["camera"])
        if mistake:
            raise CalibrationError(mistake)
    refuse_mirrors(start.poses, lit)
    return start, apart_px


def _without_outliers(
    observations: list[Observation], solution: Solution, model: Model
) -> tuple[list[Observation], Solution, list[Rejected]]:
    """The same fitted anew without points that lie wrong, until there are none."""
    left, rejected = outliers.budget(observations), list[Rejected]()
    while True:
        observations, found = outliers.reject(observations, solution, left)
        if not found:
            return observations, solution, rejected
        rejected += found
        solution = adjust_bundle(observations, solution, model)


def _candidates(level: DistortionModel | Literal["auto"], few: bool) -> tuple[DistortionModel, ...]:
    """The levels to try, the simplest first; `auto` has no choice when the poses are few."""
    if level == "auto":
        return (SIMPLEST,) if few else tuple(DistortionModel)
    return (level,)


def _tried(
    observations: Sequence[Observation], settled: Solution, model: Model, level: DistortionModel
) -> tuple[ModelTrial, Solution, list[Residuals] | None]:
    """What a level reaches, its fit, and its residuals in each pose when that was left out.

    settled: the fit of `model`, from which that of another level starts.
    """
    own = replace(model, level=level)
    solution = settled if level is model.level else adjust_bundle(observations, settled, own)
    fitted = [solution.residuals(i, o) for i, o in enumerate(observations)]
    held = _leave_one_out(observations, solution, own)
    return ModelTrial(level, _rms_px(fitted), _rms_px(held) if held else None), solution, held


def _leave_one_out(
    observations: Sequence[Observation], solution: Solution, model: Model
) -> list[Residuals] | None:
    """Residuals in each pose when all else is fitted to the others, and only its pose to it."""
    if len(observations) <= LEAST_POSES:
        return None
    held_out = []
    for held, observation in enumerate(observations):
        others = [o for i, o in enumerate(observations) if i != held]
        trained = adjust_bundle(
            others, replace(solution, poses=np.delete(solution.poses, held, axis=0)), model
        )
        pose = fit_pose(observation, trained, solution.poses[held])
        held_out.append(replace(trained, poses=pose[None]).residuals(0, observation))
    return held_out


def _chosen(tried: Sequence[tuple[ModelTrial, Solution, list[Residuals] | None]]) -> int:
    """Which to take, simplest first in `tried`; poses are compared one by one, for some are always worse."""
    if len(tried) == 1:
        return 0
    errors = np.array([[_mean_square(pair) for pair in held] for _, _, held in tried if held])
    best = errors[np.argmin(errors.mean(axis=1))]
    excess = errors - best
    doubt = excess.std(axis=1, ddof=1) / np.sqrt(excess.shape[1])
    return int(np.flatnonzero(excess.mean(axis=1) <= np.maximum(doubt, LEAST_GAIN * best.mean()))[0])


def _mean_square(pair: Residuals) -> float:
    return float(np.mean(np.sum(np.concatenate(pair) ** 2, axis=1)))


def _rms_px(residuals: Sequence[Residuals]) -> dict[str, float]:
    cameras, projectors = zip(*residuals, strict=True)
    return {"camera": rms(cameras), "projector": rms(projectors), "joint": rms(cameras + projectors)}


def _enough(observations: Sequence[Observation], left_out: dict[str, str]) -> None:
    if len(observations) >= LEAST_POSES:
        return
    why = f" ({_reasons(left_out)})" if left_out else ""
    raise CalibrationError(
        f"only {len(observations)} of {len(observations) + len(left_out)} poses can be used, "
        f"at least {LEAST_POSES} are needed{why}; capture more poses, each tilted differently"
    )


def _reasons(left_out: Mapping[str, str]) -> str:
    """Why poses are left out, a reason that several share once."""
    poses: dict[str, list[str]] = defaultdict(list)
    for name, words in left_out.items():
        poses[words.removeprefix(f"{name}: ")].append(name)
    return "; ".join(
        f"{names[0]}: {reason}" if len(names) == 1 else f"{names[0]} and {len(names) - 1} more: {reason}"
        for reason, names in poses.items()
    )


def _determined(solution: Solution, sigma: dict[str, float]) -> None:
    """Refuse focal lengths that the poses leave open: `CalibrationError`."""
    apart_deg = coverage.spread_of_tilts([transform(p) for p in solution.poses])
    parallel = f"all poses are parallel, to within {apart_deg:.1f}°, and do not determine "
    advice = "add some that are tilted by 20° or more, each time differently"
    why = f"{parallel}it" if apart_deg < coverage.PARALLEL_DEG else "the poses do not determine it"
    for device in ("camera", "projector"):
        for index, term in enumerate(("fx", "fy")):
            focal, doubt = getattr(solution, device)[index], sigma[f"{device}.{term}"]
            if doubt > WORST_FOCAL * focal:
                raise CalibrationError(
                    f"the {device}'s focal length is {focal:.0f} ± {doubt:.0f} px: {why}; {advice}"
                )
    if apart_deg < coverage.PARALLEL_DEG:  # the doubt is small only if the distortion is as assumed
        raise CalibrationError(f"{parallel}the focal lengths; {advice}")
