"""Choice of the next pose: that which lessens the uncertainty of form and place in the working volume most.

What a pose will contribute is known before it is taken: the derivatives of its points by all parameters, and
the sizes of the errors that the poses so far show. Added to the normal equations of these they give the
covariance that will be (I-optimal design: least mean variance of what is to be predicted; F. Pukelsheim,
"Optimal design of experiments", 1993). What counts is the product of the uncertainties of form and of place:
the best pose for form alone would leave the place of everything poorly known, and the reverse.
Errors that the points of one pose share count as in `pose_effects`.

The poses' own parameters are eliminated from the normal equations, one pose after the other (Schur
complement), so that each candidate is a sum of two small matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from fpplab.characterisation.estimate import JointEstimate
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import (
    ErrorSizes,
    Solution,
    compose_with_derivatives,
    project_with_derivatives,
    vectors_of,
)
from fpplab.characterisation.pose_effects import FUNCTIONS, effects_of_pose
from fpplab.characterisation.problem import Problem
from fpplab.characterisation.working_volume import WorkingVolume
from fpplab.core.blas import one_blas_thread
from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform
from fpplab.targets.limits import TARGET_LIMITS


def expected_observation(estimate: JointEstimate, pose: RigidTransform) -> Observation:
    """Predict what a pose will show, without errors."""
    best, calibration = estimate.solution, estimate.calibration
    vector, places = vectors_of(pose), pose.apply(estimate.solution.board)
    visible = calibration.camera.sees(places) & calibration.projector.sees(
        places, calibration.T_projector_camera
    )
    points = best.board[visible]
    camera_px = project_with_derivatives(points, vector, best.camera)[0]
    projector_px = project_with_derivatives(
        points, compose_with_derivatives(vector, best.T_projector_camera)[0], best.projector
    )[0]
    return Observation("next", np.flatnonzero(visible), camera_px, projector_px)


@dataclass(frozen=True, eq=False)
class Design:
    """What is known from the poses so far about devices and board, the poses' own parameters eliminated."""

    estimate: JointEstimate  # of the poses so far
    information: Floats  # (y, y) normal equations of devices and board
    shared: Floats  # (y, y) covariance of their right-hand side by errors that the points of one pose share
    point_slopes: Floats  # (y, k) mm, factors of the derivatives of points and their form by the devices

    @classmethod
    def of(cls, estimate: JointEstimate, volume: WorkingVolume) -> Design:
        thin = _thin_board_points(estimate)
        problem = Problem(thin.observations, thin.model, thin.sizes, thin.solution)
        vector, best = problem.pack(thin.solution), thin.solution
        limit = thin.model.settings.huber_limit
        matrix, _ = problem.normal_equations(vector, limit)
        through = []
        for index in range(len(thin.observations)):
            basis = effects_of_pose(problem, index, best)
            _, weight = problem.weighted_residuals(index, best, limit)
            through.append(problem.transposed(index, best, weight[:, None] * basis) * _shared_px(thin.sizes))
        information, shared = _eliminate_poses(problem, matrix, np.hstack(through))
        # Of the devices alone, and of no higher rank than they have parameters.
        factors = [
            np.asarray(np.linalg.qr(slopes, mode="r")).T for slopes in volume.slopes(best, thin.model.level)
        ]
        point_slopes = np.zeros((len(information), sum(f.shape[1] for f in factors)))
        point_slopes[: len(factors[0])] = np.hstack(factors)
        return cls(thin, information, shared, point_slopes)

    def predicted_mm(self, pose: RigidTransform | None = None) -> tuple[float, float]:
        """Predict the standard uncertainty of form with one more pose."""
        information, shared = self.information, self.shared
        if pose is not None:
            added = self._added_by(pose)
            if added is None:
                return np.inf, np.inf
            information, shared = information + added[0], shared + added[1]
        scale = 1.0 / np.sqrt(np.diag(information))
        factor = np.linalg.cholesky(information * np.outer(scale, scale))
        half = solve_triangular(factor, scale[:, None] * self.point_slopes, lower=True)
        solved = scale[:, None] * solve_triangular(factor, half, lower=True, trans="T")
        variances = (half**2).sum(axis=0) + (solved * (shared @ solved)).sum(axis=0)
        place, form = np.sqrt(variances.reshape(2, -1).sum(axis=1)).tolist()
        return place, form

    def _added_by(self, pose: RigidTransform) -> tuple[Floats, Floats] | None:
        """What a pose would add to `information` and `shared`."""
        observation = expected_observation(self.estimate, pose)
        if len(observation.ids) < TARGET_LIMITS.min_points:
            return None
        near = replace(self.estimate.solution, poses=vectors_of(pose)[None])
        problem = Problem((observation,), self.estimate.model, self.estimate.sizes, near)
        matrix, _ = problem.pose_equations(0, problem.pack(near))
        basis = effects_of_pose(problem, 0, near) * _shared_px(self.estimate.sizes)
        return _eliminate_poses(problem, matrix, problem.transposed(0, near, basis))


def best_pose(design: Design, candidates: Sequence[RigidTransform]) -> tuple[int, float]:
    """Choose the candidate that lessens the uncertainty of form most."""
    with one_blas_thread():
        predicted = np.array([design.predicted_mm(pose) for pose in candidates])
    best = int(np.argmin(predicted.prod(axis=1)))
    return best, float(predicted[best, 1])


def _eliminate_poses(problem: Problem, matrix: Floats, through: Floats) -> tuple[Floats, Floats]:
    """Eliminate the poses: normal equations (y, y), and covariance (y, y) of the right-hand side."""
    _, _, _, first, board = problem.vector_offsets
    poses = slice(first, board)
    others = np.delete(np.arange(len(matrix)), np.arange(first, board))
    carried = np.linalg.solve(matrix[poses, poses], np.hstack([matrix[poses][:, others], through[poses]]))
    across = matrix[others][:, poses]
    reduced = np.hstack([matrix[np.ix_(others, others)], through[others]]) - across @ carried
    reached = reduced[:, len(others) :]
    return reduced[:, : len(others)], reached @ reached.T


def _shared_px(sizes: ErrorSizes) -> Floats:
    """Standard deviation (24,) in px of each effect of a pose, in the order of `effects_of_pose`."""
    return np.repeat([sizes.camera_shared_px, sizes.projector_shared_px], 2 * FUNCTIONS)


def _thin_board_points(estimate: JointEstimate, max_points: int = 80) -> JointEstimate:
    """Keep few enough points of the board for a quick choice, each in place of several."""
    count = len(estimate.solution.board)
    kept = np.arange(0, count, -(-count // max_points))
    if len(kept) == count:
        return estimate
    share = float(np.sqrt(len(kept) / count))
    own = ("camera_px", "projector_px", "in_plane_mm", "out_of_plane_mm")
    sizes = replace(estimate.sizes, **{name: share * getattr(estimate.sizes, name) for name in own})
    row = np.full(count, -1)
    row[kept] = np.arange(len(kept))
    observations = []
    for observation in estimate.observations:
        selected = row[observation.ids] >= 0
        observations.append(
            replace(
                observation,
                ids=row[observation.ids[selected]],
                camera_px=observation.camera_px[selected],
                projector_px=observation.projector_px[selected],
            )
        )
    solution: Solution = replace(estimate.solution, board=estimate.solution.board[kept])
    model = replace(estimate.model, drawn=estimate.model.drawn[kept])
    return replace(estimate, observations=tuple(observations), solution=solution, sizes=sizes, model=model)
