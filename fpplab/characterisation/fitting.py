"""Characterisation of a camera and a projector from poses of a board.

Zhang's method for each device, then the pose between them, then everything together
(`fpplab.characterisation.bundle`), without outliers, and validated with poses that were not fitted.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

from fpplab.calibration.board import FittedBoard, FittedErrors
from fpplab.calibration.model import Calibration, Uncertainty
from fpplab.characterisation import coverage, outliers
from fpplab.characterisation.board_diagnosis import find_description_error
from fpplab.characterisation.bundle import (
    adjust_bundle,
    estimate_uncertainty,
    fit_pose,
    fits_without_each_pose,
    motions_in_poses,
    scale_error,
)
from fpplab.characterisation.drift import fit_with_drift
from fpplab.characterisation.limits import USUAL_LIMITS, CharacterisationLimits
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import (
    DEFAULT_SCALE_TOLERANCE,
    DistortionModel,
    ErrorSizes,
    ImageSize,
    Model,
    Solution,
    parameter_names,
)
from fpplab.characterisation.problem import without_poses
from fpplab.characterisation.result import Characterisation, ModelTrial, Rejected
from fpplab.characterisation.validation import Validation, compare_with_fewer_poses
from fpplab.characterisation.zhang import (
    calibrate_separately,
    check_not_mirrored,
    fit_pose_between_devices,
    matrix_of,
    rms,
    transform,
)
from fpplab.core import config
from fpplab.core.blas import one_blas_thread
from fpplab.core.conventions import Floats, Lattice
from fpplab.core.errors import CalibrationError, UndeterminedError
from fpplab.core.geometry import Pinhole
from fpplab.targets import Target

MIN_POSES = 3
"""Fewest tilted poses. Derived: Zhang's method needs as many where nothing of the device is known."""

DEFAULT_LEVEL = DistortionModel.K3
"""The level taken unless one is named: weak priors limit what the points do not determine of it."""


UNJUDGED = (
    f"{MIN_POSES} poses leave none to judge the distortion by, so {DEFAULT_LEVEL} was taken, unchecked; "
    "take more poses"
)
"""Warning when there are too few poses to compare the levels by."""

REFIT_ROUNDS = 3
"""Most iterations of the errors' sizes in fits without a pose. Chosen: they start from those of all poses."""

CERTAIN = 0.975
"""Probability at which Student's t widens the uncertainty of three poses: 95 % intervals are right."""

Fit = tuple[Solution, ErrorSizes]
"""What `adjust_bundle` returns."""

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
    validate: bool = True,
    limits: CharacterisationLimits = USUAL_LIMITS,
) -> Characterisation:
    """Calibrate both devices and the pose between them, from what `observe` measured in each pose.

    To validate, each pose is left out in turn; the uncertainty is by a formula alone without that.

    With `level="auto"` that is `DEFAULT_LEVEL`, and the errors of all levels in poses left out are given as
    well, of the others to first order. A coefficient that is held at zero would count as exact, so the
    simplest level that fits is not the one whose uncertainty is right.

    BLAS takes one thread: on matrices as small as these its threads would mostly wait for one another, on a
    busy machine for minutes.
    """
    # camera_size (width, height) px; projector_size (width, height) px
    with one_blas_thread():
        sizes = (camera_size, projector_size)
        chosen = DEFAULT_LEVEL if level == "auto" else level
        model = model_of(target, sizes, chosen, refine_board is not False, limits)
        return _characterise_fitted(
            observations, target, model, lattice, dict(left_out or {}), level == "auto", validate
        )


def _characterise_fitted(
    observations: Sequence[Observation], target: Target, model: Model, lattice: Lattice,
    missing: dict[str, str], compares_levels: bool, validates: bool,
) -> Characterisation:  # fmt: skip
    chosen = model.level
    kept, fit, separate_px = fit_consistent_poses(observations, target, model, missing)
    kept, fit, rejected = _without_outliers(kept, fit, model)
    if len(kept) > MIN_POSES:
        fit = fit_with_drift(kept, fit, model) or fit
    solution, sizes = fit
    # A model with few coefficients would hide that tilts are missing, so k1 to k3 are estimated here.
    richest = model if len(chosen.terms) > len(DEFAULT_LEVEL.terms) else replace(model, level=DEFAULT_LEVEL)
    _require_determined_focal_lengths(
        solution, estimate_uncertainty(kept, solution, richest, sizes).sigma, model.limits
    )
    has_few_poses = compares_levels and len(kept) <= MIN_POSES
    without = _without_each_pose(kept, fit, model) if validates else []
    tried = {
        level: _fit_at_level(kept, fit, model, level, without)
        for level in _candidates(chosen, compares_levels and not has_few_poses)
    }
    proof = compare_with_fewer_poses(kept, solution, model, sizes, without) if without else None
    covariance = _stated_uncertainty(kept, fit, model, proof)
    cameras, projectors = zip(*(solution.residuals(i, o) for i, o in enumerate(kept)), strict=True)
    calibration = calibration_of(target, lattice, solution, sizes, model, tried[chosen].fitted_px, covariance)
    poses = tuple(transform(p) for p in solution.poses)
    return Characterisation(
        calibration=calibration,
        observations=tuple(kept),
        poses=poses,
        camera_residuals=cameras,
        projector_residuals=projectors,
        separate_px=separate_px,
        leave_one_out_px=tried[chosen].held_out_px,
        board=solution.board,
        left_out=missing,
        sigma=covariance.sigma,
        level=chosen,
        trials=tuple(tried.values()),
        rejected=tuple(rejected),
        warnings=(
            *(UNJUDGED,) * has_few_poses,
            *_name_poses_with_motion(kept, fit, model),
            *(proof.warnings if proof else ()),
            *coverage.coverage_warnings(kept, poses, calibration, solution.board, model.limits),
        ),
        drawn=model.drawn if model.refined else None,
        solution=solution,
        sizes=sizes,
        model=model,
        validation=proof,
    )


def model_of(
    target: Target,
    image_sizes: tuple[ImageSize, ImageSize],
    level: DistortionModel,
    refined: bool = True,
    limits: CharacterisationLimits = USUAL_LIMITS,
) -> Model:
    # image_sizes (width, height) px
    tolerance = target.scale_tolerance
    scale = DEFAULT_SCALE_TOLERANCE if tolerance is None else tolerance
    return Model(level, target.points(), refined, target.tolerance_mm, scale, image_sizes, limits)


def _name_poses_with_motion(observations: Sequence[Observation], fit: Fit, model: Model) -> tuple[str, ...]:
    """Name the poses that are off as a whole by more than noise and the other poses explain, and why."""
    if not model.refined or len(observations) <= MIN_POSES:
        return ()
    shifts = motions_in_poses(observations, fit[0], model, fit[1])
    return tuple(
        f"{o.name}: the projector's coordinates of the whole board are off by {shift.shift_px:.2f} px, "
        + _reason_of(o, shift.shift_px)
        for o, shift in zip(observations, shifts, strict=True)
        if shift.chance < model.limits.max_chance / len(observations)
    )


def _reason_of(observation: Observation, shift_px: float) -> str:
    """Blame the board only where its images do not show that it stood still."""
    moved_px = observation.board_shift_px
    if moved_px is None or moved_px * observation.projector_px_per_px > 0.5 * shift_px:
        return "as if the board had moved while this pose was taken; hold it still, and take the pose again"
    return (
        f"although the board stood still ({moved_px:.3f} px in the camera's image from the first fringe set "
        "to the last)"
    )


def fit_consistent_poses(
    observations: Sequence[Observation], target: Target, model: Model, missing: dict[str, str]
) -> tuple[list[Observation], Fit, dict[str, float]]:  # fmt: skip
    """Leave out poses in which board or rig moved; give the others, their fit, and RMS px of each device."""
    assert model.image_sizes is not None
    kept, limits = list(observations), model.limits
    while True:
        _require_enough_poses(kept, missing)
        start, separate_px = _calibrate_devices_for_start(kept, target, model.image_sizes, limits)
        odd = outliers.find_moved_pose(kept, start, 5.0, limits)
        if odd is None:
            pair, separate_px["stereo"] = fit_pose_between_devices(kept, start, model.image_sizes[0])
            fit = adjust_bundle(kept, replace(start, T_projector_camera=pair), model)
            odd = outliers.find_moved_pose(kept, fit[0], 1.0, limits)
        if odd is None:
            return kept, fit, separate_px
        missing[kept[odd].name] = (
            f"{kept[odd].name}: fits {limits.max_pose_rms_ratio:g} times worse than the other poses; "
            "the board or the rig moved during the capture"
        )
        del kept[odd]


def _calibrate_devices_for_start(
    observations: Sequence[Observation],
    target: Target,
    sizes: tuple[ImageSize, ImageSize],
    limits: CharacterisationLimits,
) -> tuple[Solution, dict[str, float]]:
    """Calibrate both devices separately; refuse a poor fit that another description of the board explains."""
    try:
        start, projector_poses, separate_px = calibrate_separately(observations, target.points(), *sizes)
    except CalibrationError as error:
        if mistake := find_description_error(observations, target, sizes[0], limits=limits):
            raise CalibrationError(mistake) from error
        raise
    if separate_px["camera"] > limits.max_camera_rms_px:
        mistake = find_description_error(observations, target, sizes[0], separate_px["camera"], limits)
        if mistake:
            raise CalibrationError(mistake)
    check_not_mirrored(start.poses, projector_poses)
    return start, separate_px


def _without_outliers(
    observations: list[Observation], fit: Fit, model: Model
) -> tuple[list[Observation], Fit, list[Rejected]]:
    limits, rejected = model.limits, list[Rejected]()
    rejectable = outliers.rejectable_points(observations, limits)
    while True:
        observations, newly_rejected = outliers.reject_points(observations, fit[0], rejectable, limits)
        if not newly_rejected:
            return observations, fit, rejected
        rejected += newly_rejected
        fit = adjust_bundle(observations, fit[0], model, first=fit[1])


def _candidates(level: DistortionModel, compares_levels: bool) -> tuple[DistortionModel, ...]:
    return tuple(DistortionModel) if compares_levels else (level,)


def _fit_at_level(
    observations: Sequence[Observation], settled: Fit, model: Model, level: DistortionModel,
    without: Sequence[Solution],
) -> ModelTrial:  # fmt: skip
    """Fit one level, with errors of the sizes found for `model`, and in each pose when that was left out."""
    # without: fits of `model` to the other poses; those of the other levels are of first order.
    (solution, sizes), own = settled, replace(model, level=level)
    if level is not model.level:
        solution, _ = adjust_bundle(observations, solution, own, sizes)
        without = fits_without_each_pose(observations, solution, own, sizes) if without else ()
    fitted = [solution.residuals(i, o) for i, o in enumerate(observations)]
    held = [
        _held_out(o, near, solution.poses[k], solution.ages[k : k + 1])
        for k, (o, near) in enumerate(zip(observations, without, strict=bool(without)))
    ]
    return ModelTrial(level, _rms_px(fitted), _rms_px(held) if held else None)


def _without_each_pose(observations: Sequence[Observation], fit: Fit, model: Model) -> list[Solution]:
    """Fit all poses but one, for each in turn; nothing where too few would remain."""
    if len(observations) <= MIN_POSES:
        return []
    quick = replace(model, settings=replace(model.settings, max_rounds=REFIT_ROUNDS))
    solutions = []
    for held, first in enumerate(fits_without_each_pose(observations, fit[0], model, fit[1])):
        others = [o for i, o in enumerate(observations) if i != held]
        solutions.append(adjust_bundle(others, without_poses(first, held), quick, first=fit[1])[0])
    return solutions


def _stated_uncertainty(
    observations: Sequence[Observation], fit: Fit, model: Model, proof: Validation | None
) -> Uncertainty:
    """State the uncertainty by the errors' sizes, widened by the jackknife, or without one by Student's t.

    The size of what poses share comes from one pose less than there are.
    """
    if proof is not None:
        longer = scale_error(fit[0], model)
        return Uncertainty(parameter_names(model.level), proof.covariance + np.outer(longer, longer))
    wider = t.ppf(CERTAIN, len(observations) - 1) / norm.ppf(CERTAIN)
    shared = {name: wider * getattr(fit[1], name) for name in ("camera_shared_px", "projector_shared_px")}
    return estimate_uncertainty(observations, fit[0], model, replace(fit[1], **shared))


def _held_out(
    observation: Observation, near: Solution, start: Floats, age: NDArray[np.intp]
) -> Residuals:  # fmt: skip
    """Compute the residuals in a pose when only its own pose is fitted to it, all else to the others."""
    return near.at_pose(fit_pose(observation, near, start, age), age).residuals(0, observation)


def _rms_px(residuals: Sequence[Residuals]) -> dict[str, float]:
    cameras, projectors = zip(*residuals, strict=True)
    return {"camera": rms(cameras), "projector": rms(projectors), "joint": rms(cameras + projectors)}


def _require_enough_poses(observations: Sequence[Observation], left_out: dict[str, str]) -> None:
    if len(observations) >= MIN_POSES:
        return
    why = f" ({_reasons(left_out)})" if left_out else ""
    shared = {reason.removeprefix(f"{name}: ") for name, reason in left_out.items()}
    is_same_for_all = not observations and len(left_out) >= MIN_POSES and len(shared) == 1
    remedy = "correct this first" if is_same_for_all else "capture more poses, each tilted differently"
    raise UndeterminedError(
        f"only {len(observations)} of {len(observations) + len(left_out)} poses can be used, "
        f"at least {MIN_POSES} are needed{why}; {remedy}"
    )


def _reasons(left_out: Mapping[str, str]) -> str:
    """Say why poses are left out, a reason that several share only once."""
    poses: dict[str, list[str]] = defaultdict(list)
    for name, reason in left_out.items():
        poses[reason.removeprefix(f"{name}: ")].append(name)
    return "; ".join(
        f"{names[0]}: {reason}" if len(names) == 1 else f"{names[0]} and {len(names) - 1} more: {reason}"
        for reason, names in poses.items()
    )


def _require_determined_focal_lengths(
    solution: Solution, sigma: dict[str, float], limits: CharacterisationLimits
) -> None:
    apart_deg = coverage.spread_of_tilts([transform(p) for p in solution.poses])
    parallel = f"all poses are parallel, to within {apart_deg:.1f}°, and do not determine "
    advice = "add some that are tilted by 20° or more, each time differently"
    why = f"{parallel}it" if apart_deg < limits.parallel_deg else "the poses do not determine it"
    for device in ("camera", "projector"):
        for index, term in enumerate(("fx", "fy")):
            focal, doubt = getattr(solution, device)[index], sigma[f"{device}.{term}"]
            if doubt > limits.max_focal_uncertainty * focal:
                raise CalibrationError(
                    f"the {device}'s focal length is {focal:.0f} ± {doubt:.0f} px: {why}; {advice}"
                )
    if apart_deg < limits.parallel_deg:  # the doubt is small only if the distortion is as assumed
        raise CalibrationError(f"{parallel}the focal lengths; {advice}")


def calibration_of(
    target: Target,
    lattice: Lattice,
    solution: Solution,
    sizes: ErrorSizes,
    model: Model,
    rms_px: dict[str, float],
    uncertainty: Uncertainty,
) -> Calibration:
    assert model.image_sizes is not None
    errors = FittedErrors(
        camera_px=sizes.camera_px,
        projector_px=sizes.projector_px,
        camera_shared_px=sizes.camera_shared_px,
        projector_shared_px=sizes.projector_shared_px,
        poses=len(solution.poses),
        carried=solution.carried,
        scale=model.scale_tolerance,
    )
    camera_size, projector_size = model.image_sizes
    return Calibration(
        Pinhole(camera_size, matrix_of(solution.camera), solution.camera[4:]),
        Pinhole(projector_size, matrix_of(solution.projector), solution.projector[4:], lattice),
        transform(solution.T_projector_camera),
        rms_px,
        uncertainty,
        FittedBoard(config.plain(target), solution.board, errors),
    )
