"""Bundle adjustment of camera, projector, the pose between them, and every pose of the board.

Both devices see the same points of the same board, so one least-squares problem contains all that is
known (Triggs et al., "Bundle adjustment: a modern synthesis", 2000). How large the errors of each kind are is
estimated from the residuals themselves, as variance components.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, replace

import numpy as np
from scipy.linalg import cho_solve
from scipy.optimize import least_squares

from fpplab.calibration.model import INTRINSICS, POSE, Uncertainty
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import ErrorSizes, Model, Solution
from fpplab.characterisation.problem import EFFECTS, SHIFTS, Problem
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError

SOFT = 3.0
"""Residuals beyond this many robust standard deviations enter linearly, not squared (Huber)."""

CLIPPED = 0.99501
"""Mean square of a normal variable that is cut off at `SOFT` standard deviations."""

LEAST_EIGENVALUE = 1e-13
"""Least significant eigenvalue of normal equations scaled to a diagonal of ones, relative to the greatest."""

UNDETERMINED = "the poses do not determine all parameters; add some that are tilted by 20° or more"
"""Message for poses that leave a parameter undetermined."""

MOST_DAMPING = 1e8
"""Damping at which the fit ends: no step reduces the residuals."""

LEAST_GAIN = 1e-8
"""Relative reduction of the loss at which the fit ends: for 10 000 residuals a hundredth of a standard deviation."""

ROUNDS = 20
"""Most iterations of the estimate of the errors' sizes."""

SETTLED = 0.01
"""Relative change of the errors' sizes at which their iteration ends."""

FIRST_MM = 0.03
"""Size of the errors of the board's points in mm from which the estimate starts, without a tolerance."""

FIRST_EFFECTS = (0.02, 0.01)
"""Sizes of the effects of a pose from which the estimate starts: shifts in px, bending in mm."""

LEAST_PX = 1e-6
"""Least standard deviation in px that is estimated."""

LEAST_SHARE = 0.02
"""Least size of the errors of board and poses that is estimated, relative to the noise of the camera's points: smaller
ones have no effect."""


def adjust_bundle(
    observations: Sequence[Observation],
    start: Solution,
    model: Model,
    sizes: ErrorSizes | None = None,
    *,
    first: ErrorSizes | None = None,
) -> tuple[Solution, ErrorSizes]:
    """Find the best solution near a start, by a robust fit, and how large the errors of each kind are.

    Parameters
    ----------
    observations : Sequence[Observation]
        The poses.
    start : Solution
        Initial values.
    model : Model
        Which parameters are estimated.
    sizes : ErrorSizes or None
        Of the errors, where they are known; None estimates them.
    first : ErrorSizes or None
        From which the estimate starts.

    Returns
    -------
    solution : Solution
        At the minimum of Huber's loss of the whitened residuals.
    sizes : ErrorSizes
        By which they were weighted.

    Raises
    ------
    CalibrationError
        The poses do not determine all parameters.

    References
    ----------
    Triggs et al., "Bundle adjustment: a modern synthesis", 2000. W. Förstner, "Ein Verfahren zur Schätzung von
    Varianz- und Kovarianzkomponenten", 1979, for the variance components.
    """
    first = sizes or first or _first_sizes(observations, start, model)
    problem = Problem(tuple(observations), model, first, start)
    vector = _descend(problem, problem.pack(start))
    for _ in range(1 if sizes else ROUNDS):
        near = problem.unpack(vector)
        found = sizes or variance_components(replace(problem, near=near), vector)
        change = np.log(np.array(astuple(found)) / np.array(astuple(problem.sizes)))
        problem = replace(problem, near=near, sizes=found)
        if sizes is None and np.abs(change).max() < SETTLED:
            break
        vector = _descend(problem, vector)
    return problem.unpack(vector), problem.sizes


def _first_sizes(observations: Sequence[Observation], start: Solution, model: Model) -> ErrorSizes:
    """Sizes from the residuals of the start, robustly."""
    pairs = [start.residuals(i, o) for i, o in enumerate(observations)]
    noise = [
        max(1.4826 * float(np.median(np.abs(np.concatenate(device)))), LEAST_PX)
        for device in zip(*pairs, strict=True)
    ]
    board = (model.tolerance_mm or FIRST_MM,) * 2
    return ErrorSizes(noise[0], noise[1], *board, *FIRST_EFFECTS)


def variance_components(problem: Problem, vector: Floats) -> ErrorSizes:
    """Estimate the errors' sizes once from the residuals at a solution: one step of an iteration.

    The squares of the residuals of one kind are divided by their redundancy, the number of residuals less the
    trace of their share of the normal equations. At the fixed point this is the estimate of restricted maximum
    likelihood.

    Parameters
    ----------
    problem : Problem
        With the sizes so far.
    vector : Floats
        (n,) parameters at its minimum.

    Returns
    -------
    ErrorSizes
        The next.

    Raises
    ------
    CalibrationError
        A parameter is not determined.

    References
    ----------
    W. Förstner, 1979.
    """
    inverse = _inverse(problem, problem.normal_equations(vector, SOFT)[0])
    of_camera, _ = problem.normal_equations(vector, SOFT, camera_alone=True)
    errors, pulls = problem.errors(vector), problem.pulls(vector)
    known, _, sigmas = problem.priors
    held = np.diag(inverse)[known] / sigmas**2
    used_by_camera = float(np.sum(inverse * of_camera))
    used = [used_by_camera, len(vector) - used_by_camera - float(held.sum())]
    groups = [(errors[i], len(errors[i]) - used[i]) for i in (0, 1)]
    sizes = problem.sizes
    found = [
        max(size * _ratio(*group), LEAST_PX)
        for size, group in zip((sizes.camera_px, sizes.projector_px), groups, strict=True)
    ]
    if not problem.model.refined:
        return replace(sizes, camera_px=found[0], projector_px=found[1])
    _, _, _, _, effects, board = problem.heads
    place = problem.priors[0]
    of_effect, of_board = (place - effects) % EFFECTS, (place - board) % 3
    within = (place >= board) & (of_board < 2), (place >= board) & (of_board == 2)
    moving = (place >= effects) & (place < board)
    rows = (*within, moving & (of_effect < SHIFTS), moving & (of_effect >= SHIFTS))
    pitch = float(np.median(problem.near.poses[:, 5])) / problem.near.camera[0]
    least = LEAST_SHARE * found[0] * np.array([pitch, pitch, 1.0, pitch])
    others = [
        max(size * _ratio(pulls[row], float((1.0 - held[row]).sum())), float(floor))
        for size, row, floor in zip(astuple(sizes)[2:], rows, least, strict=True)
    ]
    return ErrorSizes(*found, *others)


def _ratio(residuals: Floats, redundancy: float) -> float:
    """Return the estimated standard deviation of residuals that should have one of 1."""
    if redundancy < 1e-3 * len(residuals):
        return 1.0
    squares = float(np.sum(np.minimum(residuals**2, SOFT**2))) / CLIPPED
    return float(np.sqrt(squares / redundancy))


def uncertainty(
    observations: Sequence[Observation], best: Solution, model: Model, sizes: ErrorSizes
) -> Uncertainty:
    """Estimate the uncertainty of the devices and of the pose between them.

    The covariance is marginal: it contains the uncertainty of the poses, of what moved or bent in them, of the
    board's shape and of its scale.

    Parameters
    ----------
    observations : Sequence[Observation]
        The poses.
    best : Solution
        What `adjust_bundle` found for this model.
    model : Model
        Which parameters are estimated.
    sizes : ErrorSizes
        Of the errors, as `adjust_bundle` found them.

    Returns
    -------
    Uncertainty
        Covariance of the estimated parameters.

    Raises
    ------
    CalibrationError
        The poses do not determine the parameters.
    """
    problem = Problem(tuple(observations), model, sizes, best)
    normal, _ = problem.normal_equations(problem.pack(best))
    shared = slice(problem.heads[2])
    covariance = _inverse(problem, normal)[shared, shared]
    # All lengths grow with the board's, and no image changes.
    longer = np.zeros(len(covariance))
    longer[-3:] = model.scale_tolerance * best.T_projector_camera[3:]
    covariance = covariance + np.outer(longer, longer)
    terms = [f"{d}.{term}" for d in ("camera", "projector") for term in model.level.terms]
    names = (*terms, *(f"T_projector_camera.{term}" for term in POSE))
    return Uncertainty(names, 0.5 * (covariance + covariance.T))


def effect_significance(
    observations: Sequence[Observation], best: Solution, model: Model, sizes: ErrorSizes
) -> tuple[Floats, Floats]:
    """Estimate what a board that moved while a pose was taken shifts, and whether noise alone explains it.

    Parameters
    ----------
    observations : Sequence[Observation]
        The poses.
    best : Solution
        What `adjust_bundle` found for this model, which has to be refined.
    model : Model
        Which parameters are estimated.
    sizes : ErrorSizes
        Of the errors.

    Returns
    -------
    shift_px : Floats
        (M,) by how much that shifts the projector's coordinates in this pose.
    chi_square : Floats
        (M,) of `SHIFTS` degrees of freedom, if the board of this pose did not move.

    Raises
    ------
    CalibrationError
        The poses do not determine the parameters.
    """
    problem = Problem(tuple(observations), model, sizes, best)
    inverse = _inverse(problem, problem.normal_equations(problem.pack(best), SOFT)[0])
    first, squares = problem.heads[4], []
    for index, effects in enumerate(best.pose_effects):
        own = slice(first + EFFECTS * index, first + EFFECTS * index + SHIFTS)
        posterior = inverse[own, own]
        # Without the prior: what the data alone say of the shifts.
        pull = np.linalg.solve(posterior, effects[:SHIFTS])
        values, vectors = np.linalg.eigh(np.linalg.inv(posterior) - np.eye(SHIFTS) / sizes.shift_px**2)
        sound = values > 1e-6 / sizes.shift_px**2
        squares.append(float(np.sum((vectors.T @ pull)[sound] ** 2 / values[sound])))
    return np.linalg.norm(best.pose_effects[:, :SHIFTS], axis=1), np.array(squares)


def _inverse(problem: Problem, normal: Floats) -> Floats:
    """Invert normal equations; raise `CalibrationError` where a parameter is not determined."""
    scale = np.sqrt(np.diag(normal))
    if np.any(scale == 0):
        raise CalibrationError(UNDETERMINED)
    scaled = normal / np.outer(scale, scale)
    rational = np.arange(INTRINSICS.index("k4"), len(problem.model.level.terms))
    rational = np.concatenate([rational, len(problem.model.level.terms) + rational])
    # k4, k5, k6 of a lens may be undetermined by any poses; all other parameters must be determined.
    others = np.delete(np.arange(len(normal)), rational)
    values = np.linalg.eigvalsh(scaled[np.ix_(others, others)])
    if values[0] < LEAST_EIGENVALUE * values[-1]:
        raise CalibrationError(UNDETERMINED)
    values, vectors = np.linalg.eigh(scaled)
    inverse = (vectors / np.maximum(values, LEAST_EIGENVALUE * values[-1])) @ vectors.T
    return np.asarray(inverse / np.outer(scale, scale))


def _descend(problem: Problem, vector: Floats) -> Floats:
    """Minimise Huber's loss by Levenberg-Marquardt's method with reweighting."""
    damping = 1e-6
    cost = _huber(problem.misfit(vector))
    for _ in range(200):
        normal, gradient = problem.normal_equations(vector, SOFT)
        normal[np.diag_indices_from(normal)] *= 1.0 + damping
        try:
            # NumPy's factorisation, not SciPy's, which spends 100 ms on waking threads for small matrices.
            trial = vector - cho_solve((np.linalg.cholesky(normal), True), gradient)
        except (np.linalg.LinAlgError, ValueError) as error:
            damping *= 10.0
            if damping > MOST_DAMPING:
                raise CalibrationError(UNDETERMINED) from error
            continue
        gain = cost - _huber(problem.misfit(trial))
        if gain > 0:
            vector, cost, damping = trial, cost - gain, 0.1 * damping
        else:
            damping *= 10.0
        if abs(gain) <= LEAST_GAIN * cost or damping > MOST_DAMPING:
            break
    return vector


def _huber(residuals: Floats) -> float:
    size = np.abs(residuals)
    return float(np.sum(np.where(size <= SOFT, size**2, SOFT * (2 * size - SOFT))))


def fit_pose(observation: Observation, solution: Solution, start: Floats) -> Floats:
    """Fit the pose of the board in one capture, with everything else held.

    Parameters
    ----------
    observation : Observation
        The capture.
    solution : Solution
        The devices and the board.
    start : Floats
        (6,) initial pose.

    Returns
    -------
    Floats
        (6,) `T_camera_target`: rotation vector in rad and translation in mm.
    """

    def misfit(pose: Floats) -> Floats:
        pair = replace(solution, poses=pose[None]).residuals(0, observation)
        return np.concatenate(pair).ravel()

    return np.asarray(least_squares(misfit, start, x_scale="jac", method="lm").x)
