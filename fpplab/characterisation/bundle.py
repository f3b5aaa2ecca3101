"""Bundle adjustment of camera, projector, the pose between them, and every pose of the board.

Both devices see the same points of the same board, so one least-squares problem contains all that is
known (Triggs et al., "Bundle adjustment: a modern synthesis", 2000). How large the errors of each kind are is
estimated from the residuals themselves, as variance components.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.optimize import least_squares

from fpplab.calibration.model import INTRINSICS, Uncertainty
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import BundleSettings, ErrorSizes, Model, Solution, parameter_names
from fpplab.characterisation.pose_effects import (
    PoseEffects,
    PoseShift,
    pose_effects,
    pose_shifts,
    rough_residuals,
    widened_variances,
)
from fpplab.characterisation.problem import Problem
from fpplab.core.conventions import Floats
from fpplab.core.errors import UndeterminedError
from fpplab.core.robust import robust_spread

UNDETERMINED = "the poses do not determine all parameters; add some that are tilted by 20° or more"
"""Message for poses that leave a parameter undetermined."""


def adjust_bundle(
    observations: Sequence[Observation],
    start: Solution,
    model: Model,
    sizes: ErrorSizes | None = None,
    *,
    first: ErrorSizes | None = None,
) -> tuple[Solution, ErrorSizes]:
    """Find the best solution near a start, by a robust fit, and how large the errors of each kind are."""
    first = sizes or first or _first_sizes(observations, start, model)
    problem = Problem(tuple(observations), model, first, start)
    vector = _descend(problem, problem.pack(start))
    for _ in range(0 if sizes else model.settings.max_rounds):
        near = problem.unpack(vector)
        estimated = variance_components(replace(problem, near=near), vector)
        change = np.log(np.array(estimated.iterated) / np.array(problem.sizes.iterated))
        problem = replace(problem, near=near, sizes=estimated)
        if np.abs(change).max() < model.settings.max_settled_change:
            break
        vector = _descend(problem, vector)
    return problem.unpack(vector), problem.sizes


def _first_sizes(observations: Sequence[Observation], start: Solution, model: Model) -> ErrorSizes:
    """Sizes from the residuals of the start, robustly."""
    pairs = [start.residuals(i, o) for i, o in enumerate(observations)]
    min_px = model.settings.min_error_px
    noise = [robust_spread(np.concatenate(device), min_px) for device in zip(*pairs, strict=True)]
    board = (model.tolerance_mm or model.settings.initial_board_error_mm,) * 2
    return ErrorSizes(noise[0], noise[1], *board)


def variance_components(problem: Problem, vector: Floats) -> ErrorSizes:
    """Estimate the errors' sizes once from the residuals at a solution: one step of an iteration."""
    # The noise comes from what remains of each pose's residuals without the smooth functions of its effects,
    # so that it does not depend on them: squares over their redundancy, which is the number of residuals less
    # the trace of their share of the normal equations. Robust weights would take effects for outliers.
    # vector (n,)
    settings = problem.model.settings
    normal, gradient = problem.normal_equations(vector)
    inverse = inverse_of(problem, normal)
    with_prior, _, sigmas = problem.priors
    held = np.diag(inverse)[with_prior] / sigmas**2
    effects = pose_effects(problem, vector, inverse, np.inf)
    effects = replace(effects, scores=effects.scores + effects.passed.T @ gradient)
    variances, uncertainties = effects.variances()
    leaked = effects.leaked @ variances[effects.device]
    rough, redundancy = rough_residuals(problem, vector, inverse)
    noise = [
        max(size * _residual_to_expected_ratio(residuals, free, 0.0, settings), settings.min_error_px)
        for size, residuals, free in zip(problem.sizes.independent, rough, redundancy, strict=False)
    ]
    prior_residuals = problem.prior_residuals(vector)
    board = list(problem.sizes.independent[2:])
    if problem.model.refined:
        pitch = float(np.median(problem.near.poses[:, 5])) / problem.near.camera[0]
        board = [
            max(
                size
                * _residual_to_expected_ratio(
                    prior_residuals[row], float((1.0 - held[row]).sum()), leak, settings
                ),
                settings.min_board_error_ratio * noise[0] * pitch,
            )
            for size, row, leak in zip(board, problem.board_rows, leaked, strict=True)
        ]
    shared = np.sqrt(widened_variances(variances, uncertainties)).tolist()
    drift_px = _drift_px(problem, prior_residuals, held)
    return replace(ErrorSizes(*noise, *board, *shared), drift_px=drift_px)


def _drift_px(problem: Problem, prior_residuals: Floats, held: Floats) -> float:
    """Size of the steps by which the projector's picture walks; 0 where no steps are fitted."""
    rows = problem.priors[0] >= problem.length - problem.near.steps.size
    squares, redundancy = np.sum(prior_residuals[rows] ** 2), np.sum(1.0 - held[rows])
    return float(problem.sizes.drift_px * np.sqrt(squares / redundancy)) if rows.any() else 0.0


def _residual_to_expected_ratio(
    residuals: Floats, redundancy: float, leaked: float, settings: BundleSettings
) -> float:
    """Return the estimated standard deviation of residuals that should have one of 1."""
    # leaked: the part of their sum of squares that effects of the poses cause.
    if redundancy < 1e-3 * len(residuals):
        return 1.0
    clipped = float(np.sum(np.minimum(residuals**2, settings.huber_limit**2)))
    squares = clipped / settings.clipped_mean_square
    # Residuals far beyond the clip must still show that their size was taken too small.
    unclipped = max(squares, robust_spread(residuals, 0.0) ** 2 * residuals.size)
    return float(np.sqrt(max(squares - leaked, settings.min_independent_share * unclipped) / redundancy))


def estimate_uncertainty(
    observations: Sequence[Observation], best: Solution, model: Model, sizes: ErrorSizes
) -> Uncertainty:
    """Estimate the uncertainty of the devices and of the pose between them."""
    # The covariance is marginal: it contains the uncertainty of the poses, of the errors that the points of
    # one pose share, of the board's shape and of its scale.
    longer = scale_error(best, model)
    shared = slice(len(longer))
    joint = covariance_with_poses(observations, best, model, sizes)
    covariance = joint[shared, shared] + np.outer(longer, longer)
    return Uncertainty(parameter_names(model.level), 0.5 * (covariance + covariance.T))


def covariance_with_poses(
    observations: Sequence[Observation], best: Solution, model: Model, sizes: ErrorSizes
) -> Floats:
    """Covariance (n + 6 P, n + 6 P) of devices and poses together, the board's scale taken as known."""
    problem = Problem(tuple(observations), model, sizes, best)
    _, _, carried, poses, board = problem.vector_offsets
    inverse, effects = _effects(problem, best)
    at = np.append(np.arange(carried), np.arange(poses, board))
    passed = (
        effects.passed[at] * np.array([sizes.camera_shared_px, sizes.projector_shared_px])[effects.device]
    )
    return np.asarray(inverse[np.ix_(at, at)] + passed @ passed.T)


def scale_error(best: Solution, model: Model) -> Floats:
    """Compute how an error of the board's scale changes the parameters: lengths grow, no image changes."""
    # returns (n,)
    lenses = np.zeros(2 * len(model.level.terms) + 3)
    return np.append(lenses, model.scale_tolerance * best.T_projector_camera[3:])


def motions_in_poses(
    observations: Sequence[Observation], best: Solution, model: Model, sizes: ErrorSizes
) -> list[PoseShift]:
    """Estimate by how much the board of each pose moved while it was taken."""
    return pose_shifts(_effects(Problem(tuple(observations), model, sizes, best), best)[1])


def _effects(problem: Problem, best: Solution) -> tuple[Floats, PoseEffects]:
    """Inverse (n, n) of the normal equations, and the effects of the poses."""
    vector, limit = problem.pack(best), problem.model.settings.huber_limit
    inverse = inverse_of(problem, problem.normal_equations(vector, limit)[0])
    return inverse, pose_effects(problem, vector, inverse, limit)


def fits_without_each_pose(
    observations: Sequence[Observation], best: Solution, model: Model, sizes: ErrorSizes
) -> list[Solution]:
    """Fit all poses but one, for each in turn, to first order."""
    # That is one step of Gauss and Newton from the joint fit.
    problem = Problem(tuple(observations), model, sizes, best)
    vector, (_, _, carried, first, _) = problem.pack(best), problem.vector_offsets
    limit, damping = model.settings.huber_limit, model.settings.initial_damping**2
    parts = [problem.pose_equations(index, vector, limit) for index in range(len(observations))]
    normal, gradient = problem.normal_equations(vector, limit)
    solutions = []
    for index, (own, pull) in enumerate(parts):
        others = np.delete(np.arange(len(vector)), np.arange(first + 6 * index, first + 6 * index + 6))
        remaining = (normal - own)[np.ix_(others, others)]
        scale = 1.0 / np.sqrt(np.diag(remaining))
        try:
            scaled = remaining * np.outer(scale, scale) + damping * np.eye(len(remaining))
            factor = np.linalg.cholesky(scaled)
        except np.linalg.LinAlgError as error:
            raise UndeterminedError(UNDETERMINED) from error
        moved = vector.copy()
        moved[others] -= scale * cho_solve((factor, True), scale * (gradient - pull)[others])
        moved[carried] = np.clip(moved[carried], 0.0, 1.0)
        solutions.append(problem.unpack(moved))
    return solutions


def inverse_of(problem: Problem, normal: Floats) -> Floats:
    """Invert normal equations."""
    # normal (n, n); returns (n, n)
    scale = np.sqrt(np.diag(normal))
    if np.any(scale == 0):
        raise UndeterminedError(UNDETERMINED)
    scaled = normal / np.outer(scale, scale)
    rational = np.arange(INTRINSICS.index("k4"), len(problem.model.level.terms))
    rational = np.concatenate([rational, len(problem.model.level.terms) + rational])
    # k4, k5, k6 of a lens may be undetermined by any poses; all other parameters must be determined.
    others = np.delete(np.arange(len(normal)), rational)
    values, vectors = np.linalg.eigh(scaled)
    judged = np.linalg.eigvalsh(scaled[np.ix_(others, others)]) if len(rational) else values
    min_ratio = problem.model.settings.min_eigenvalue_ratio
    if judged[0] < min_ratio * judged[-1]:
        raise UndeterminedError(UNDETERMINED)
    inverse = (vectors / np.maximum(values, min_ratio * values[-1])) @ vectors.T
    return np.asarray(inverse / np.outer(scale, scale))


def _descend(problem: Problem, vector: Floats) -> Floats:
    """Minimise Huber's loss by reweighted Levenberg-Marquardt, the share carried within 0 to 1."""
    settings, carried = problem.model.settings, problem.vector_offsets[2]
    damping, limit = settings.initial_damping, settings.huber_limit
    cost = _huber(problem.misfit(vector), limit)
    for _ in range(settings.max_steps):
        normal, gradient = problem.normal_equations(vector, limit)
        _hold_at_bound(normal, gradient, carried, vector[carried])
        normal[np.diag_indices_from(normal)] *= 1.0 + damping
        try:
            # NumPy's factorisation, not SciPy's, which spends 100 ms on waking threads for small matrices.
            trial = vector - cho_solve((np.linalg.cholesky(normal), True), gradient)
        except (np.linalg.LinAlgError, ValueError) as error:
            damping *= 10.0
            if damping > settings.max_damping:
                raise UndeterminedError(UNDETERMINED) from error
            continue
        trial[carried] = np.clip(trial[carried], 0.0, 1.0)
        gain = cost - _huber(problem.misfit(trial), limit)
        if gain > 0:
            vector, cost, damping = trial, cost - gain, 0.1 * damping
        else:
            damping *= 10.0
        if abs(gain) <= settings.min_relative_gain * cost or damping > settings.max_damping:
            break
    return vector


def _hold_at_bound(normal: Floats, gradient: Floats, at: int, value: float) -> None:
    """Take a parameter out of normal equations, in place, if it is 0 or 1 and would leave that range."""
    if (value <= 0.0 and gradient[at] > 0) or (value >= 1.0 and gradient[at] < 0):
        normal[at], normal[:, at], gradient[at] = 0.0, 0.0, 0.0
        normal[at, at] = 1.0


def _huber(residuals: Floats, limit: float) -> float:
    size = np.abs(residuals)
    return float(np.sum(np.where(size <= limit, size**2, limit * (2 * size - limit))))


def fit_pose(
    observation: Observation, solution: Solution, start: Floats, age: NDArray[np.intp] | None = None
) -> Floats:  # fmt: skip
    """Fit the pose of the board in one capture, with everything else held."""
    # start (6,); age (1,); returns (6,) rad

    def misfit(pose: Floats) -> Floats:
        pair = solution.at_pose(pose, age).residuals(0, observation)
        return np.concatenate(pair).ravel()

    return np.asarray(least_squares(misfit, start, x_scale="jac", method="lm").x)
