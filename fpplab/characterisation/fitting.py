"""Characterisation of a camera and a projector from poses of a board.

Zhang's method for each device, then the pose between them, then everything together
(`fpplab.characterisation.bundle`), without outliers, and validated with poses that were not fitted.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.characterisation import coverage, outliers
from fpplab.characterisation.board_diagnosis import find_description_error
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
from fpplab.characterisation.zhang import (
    ImageSize,
    calibrate_separately,
    check_not_mirrored,
    matrix_of,
    rms,
    stereo,
    transform,
)
from fpplab.core.conventions import Floats, Lattice
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import Pinhole
from fpplab.targets import Target

LEAST_POSES = 3
"""Zhang's method needs this many tilted poses when nothing of the device is known."""

SIMPLEST = next(iter(DistortionModel))
"""The level taken unless another predicts poses left out better."""

LEAST_GAIN = 0.02
"""Least relative reduction of the mean square error in poses left out by a level with more coefficients."""

WORST_FOCAL = 0.03
"""Greatest relative uncertainty of a focal length that is accepted."""

SUSPECT_PX = 1.0
"""RMS in px of the camera alone above which other descriptions of the board are tried."""

BOARD_SIGMA_MM = 0.1
"""Standard deviation in mm of a printed board's points, where its target file does not give a tolerance."""

UNJUDGED = (
    f"{LEAST_POSES} poses leave none to judge the distortion by, so {SIMPLEST} was taken, the simplest "
    "model; take more poses, or name the model"
)
"""Warning when there are too few poses to choose the level by."""

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
    """Calibrate both devices and the pose between them, from what `observe` measured in each pose.

    With `level="auto"` that level is taken which has the smallest error in poses left out, or the simplest
    that is as good within the standard error of the difference over the poses, or within `LEAST_GAIN`. With
    only `LEAST_POSES` poses none can be left out, and the simplest level is taken, with a warning.

    Parameters
    ----------
    observations : Sequence[Observation]
        The poses.
    target : Target
        The board.
    camera_size : ImageSize
        (width, height) in px.
    projector_size : ImageSize
        (width, height) in px.
    lattice : Lattice
        Arrangement of the projector's mirrors.
    left_out : Mapping[str, str] or None
        The poses that could not be observed by name, with a sentence each that names the pose and says why.
    level : DistortionModel or 'auto'
        How many distortion coefficients are estimated.
    refine_board : bool or None
        Whether the board's own shape is estimated too, with a prior of `target.tolerance_mm`, or of
        `BOARD_SIGMA_MM` without it; None does so when the target has a tolerance.

    Returns
    -------
    Characterisation
        The calibration and all that is known about its quality.

    Raises
    ------
    CalibrationError
        Fewer than `LEAST_POSES` poses can be used (naming why each of the others cannot), the poses do not
        determine the devices, the board is not the one described, or a device sees it mirrored.

    References
    ----------
    Z. Zhang, "A flexible new technique for camera calibration", 2000.
    """
    missing = dict(left_out or {})
    most = DistortionModel.K3 if level == "auto" else level
    model = Model(most, target.points(), _board_sigma(target, refine_board))
    kept, start, separate_px = _settled(observations, target, model, (camera_size, projector_size), missing)
    kept, start, rejected = _without_outliers(kept, start, model)
    # A model with few coefficients would hide that tilts are missing, so all are estimated here.
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
        separate_px,
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
    """Select the poses that are consistent: these, their joint fit, and the RMS of the steps before it.

    The others are added to `missing`.
    """
    kept = list(observations)
    while True:
        _enough(kept, missing)
        start, separate_px = _started(kept, target, sizes)
        odd = outliers.find_moved_pose(kept, start, 5.0)
        if odd is None:
            pair, separate_px["stereo"] = stereo(kept, start, sizes[0])
            start = adjust_bundle(kept, replace(start, T_projector_camera=pair), model)
            odd = outliers.find_moved_pose(kept, start, 1.0)
        if odd is None:
            return kept, start, separate_px
        missing[kept[odd].name] = (
            f"{kept[odd].name}: fits {outliers.MOVED_POSE:g} times worse than the other poses; "
            "the board or the rig moved during the capture"
        )
        del kept[odd]


def _started(
    observations: Sequence[Observation], target: Target, sizes: tuple[ImageSize, ImageSize]
) -> tuple[Solution, dict[str, float]]:
    """Calibrate both devices separately; refuse a poor fit that another description of the board explains."""
    try:
        start, projector_poses, separate_px = calibrate_separately(observations, target.points(), *sizes)
    except CalibrationError as error:
        raise CalibrationError(
            find_description_error(observations, target, sizes[0]) or str(error)
        ) from error
    if separate_px["camera"] > SUSPECT_PX:
        mistake = find_description_error(observations, target, sizes[0], separate_px["camera"])
        if mistake:
            raise CalibrationError(mistake)
    check_not_mirrored(start.poses, projector_poses)
    return start, separate_px


def _without_outliers(
    observations: list[Observation], solution: Solution, model: Model
) -> tuple[list[Observation], Solution, list[Rejected]]:
    """Repeat the fit without outlying points until there are none."""
    left, rejected = outliers.rejection_limits(observations), list[Rejected]()
    while True:
        observations, found = outliers.reject_points(observations, solution, left)
        if not found:
            return observations, solution, rejected
        rejected += found
        solution = adjust_bundle(observations, solution, model)


def _candidates(level: DistortionModel | Literal["auto"], few: bool) -> tuple[DistortionModel, ...]:
    """List the levels to try, the simplest first; `auto` has no choice when the poses are few."""
    if level == "auto":
        return (SIMPLEST,) if few else tuple(DistortionModel)
    return (level,)


def _tried(
    observations: Sequence[Observation], settled: Solution, model: Model, level: DistortionModel
) -> tuple[ModelTrial, Solution, list[Residuals] | None]:
    """Fit one level: its errors, its fit, and its residuals in each pose when that was left out.

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
    """Compute the residuals in each pose when only its own pose is fitted to it, all else to the others."""
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
    """Choose from `tried`, simplest first, by errors pose by pose, because some poses are always worse."""
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
    """Say why poses are left out, a reason that several share only once."""
    poses: dict[str, list[str]] = defaultdict(list)
    for name, words in left_out.items():
        poses[words.removeprefix(f"{name}: ")].append(name)
    return "; ".join(
        f"{names[0]}: {reason}" if len(names) == 1 else f"{names[0]} and {len(names) - 1} more: {reason}"
        for reason, names in poses.items()
    )


def _determined(solution: Solution, sigma: dict[str, float]) -> None:
    """Raise `CalibrationError` for focal lengths that the poses do not determine."""
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
