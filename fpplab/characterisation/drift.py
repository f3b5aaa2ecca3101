"""Whether the projector's picture walks from pose to pose, as while it warms up.

A picture that lies elsewhere in each pose contradicts the one pose between the devices, and would be taken
for another geometry. So its steps from pose to pose, along both axes, are parameters of a random walk whose
size is estimated like those of all errors. The calibration then is that of the next capture, one step after
the last pose, and as uncertain as this step.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from fpplab.characterisation.bundle import adjust_bundle, inverse_of
from fpplab.characterisation.lens import scale_scatter, scales_of_poses
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import ErrorSizes, Model, Solution
from fpplab.characterisation.pose_effects import pose_effects
from fpplab.characterisation.problem import Problem
from fpplab.characterisation.working_volume import moved_points
from fpplab.core.conventions import Floats
from fpplab.core.errors import UndeterminedError
from fpplab.core.geometry import RigidTransform

UNLIMITED_ERRORS = 1e3
"""Size of steps that are estimated freely, to judge them, in standard errors of the projector's points.
Chosen: beyond any drift, and near enough that the equations can be solved in double precision."""


def fit_with_drift(
    observations: Sequence[Observation], fit: tuple[Solution, ErrorSizes], model: Model
) -> tuple[Solution, ErrorSizes] | None:
    """Fit steps of the projector's picture too; None where they do not explain the residuals, or need not."""
    # Nor do steps explain scales of the camera's image that differ from pose to pose: a lens that breathes.
    solution, sizes = fit
    count = len(observations)
    start = replace(solution, steps=np.zeros((count, 2)), ages=np.arange(count, 0, -1))
    still = replace(sizes, camera_shared_px=0.0, projector_shared_px=0.0)
    try:
        chance, drift_px = _steps_by_chance(observations, start, model, still)
    except UndeterminedError:  # beside the residuals of a twin, any step is as good as unlimited
        return None
    if chance > model.limits.max_chance:
        return None
    drifting = adjust_bundle(observations, start, model, first=replace(sizes, drift_px=drift_px))
    chance, _ = _steps_by_chance(observations, drifting[0], model, drifting[1])
    _, locked = scale_scatter(*scales_of_poses(observations, *drifting))
    return drifting if chance < model.limits.max_chance < locked else None


def drift_cost_mm(
    observations: Sequence[Observation], fit: tuple[Solution, ErrorSizes], model: Model
) -> float:
    """Compute how far one step of the drift moves points where the boards were, RMS."""
    solution, sizes = fit
    places = np.concatenate(
        [
            RigidTransform.from_vectors(pose[:3], pose[3:]).apply(solution.board[o.ids])
            for o, pose in zip(observations, solution.poses, strict=True)
        ]
    )
    free = len(model.level.terms)
    shifted = moved_points(solution, model.level, places)[:, free + 2 : free + 4]  # by the principal point
    return float(sizes.drift_px * np.sqrt(np.sum(shifted**2) / len(places)))


def _steps_by_chance(
    observations: Sequence[Observation], near: Solution, model: Model, sizes: ErrorSizes
) -> tuple[float, float]:
    """Give the probability that steps as clear as the best ones come by chance, and their RMS in px."""
    free_px = UNLIMITED_ERRORS * sizes.projector_px
    problem = Problem(tuple(observations), model, replace(sizes, drift_px=free_px), near)
    vector, limit = problem.pack(near), np.inf
    normal, gradient = problem.normal_equations(vector, limit)
    inverse = inverse_of(problem, normal)
    known = slice(problem.length - near.steps.size, problem.length - 2)  # nothing shows the last
    steps = (vector - inverse @ gradient)[known]
    effects = pose_effects(problem, vector, inverse, limit)
    shared = (
        effects.passed[known] * np.array([sizes.camera_shared_px, sizes.projector_shared_px])[effects.device]
    )
    information = np.linalg.inv(inverse[known, known] + shared @ shared.T)
    return max(_chance_without(pose, steps, information) for pose in range(len(near.ages))), float(
        np.sqrt(np.mean(steps**2))
    )


def _chance_without(pose: int, steps: Floats, information: Floats) -> float:
    """Give the probability where one pose may lie anywhere, as if its board had moved."""
    # steps (2 M - 2,); information (2 M - 2, 2 M - 2)
    own = np.zeros((len(steps) // 2 + 2, 1))
    own[pose], own[pose + 1] = 1.0, -1.0  # the step to this pose, and the one from it
    moved = np.kron(own[1:-1], np.eye(2))
    weighted = information @ moved
    remaining = information - weighted @ np.linalg.solve(moved.T @ weighted, weighted.T)
    return float(chi2.sf(steps @ remaining @ steps, len(steps) - 2))
