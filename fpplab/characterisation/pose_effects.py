"""What the errors of one pose share, because the board moved or bent, or a device warmed up.

The residuals of a pose are then not independent of one another, and the estimate is more uncertain than their
scatter says. Such effects are taken as random and smooth over the board, of a size in each device that is
estimated from the residuals. They do not move the estimate, which stays that of independent errors: with few
poses an effect of each would take over what belongs to the lenses. They widen its covariance (K.-Y. Liang and
S. Zeger, "Longitudinal data analysis using generalized linear models", 1986, with a model of the covariance
within a pose instead of the empirical one, which is of too low a rank with few poses).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import nnls
from scipy.stats import chi2, norm

from fpplab.characterisation.parameters import Solution
from fpplab.characterisation.problem import Problem
from fpplab.core.conventions import Floats

FUNCTIONS = 6
"""Number of smooth functions over the board, by which an effect of one pose changes one coordinate: the terms
of a polynomial of second degree in two variables."""


def smooth_functions(places: Floats) -> Floats:
    """Evaluate polynomials of second degree over a board that are orthogonal at its points."""
    # places (K, 2) mm; returns (K, 6)
    centred = places - places.mean(axis=0)
    x, y = (centred / np.abs(centred).max()).T
    basis, _ = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1))
    return np.asarray(basis * np.sqrt(len(places)))


@dataclass(frozen=True, eq=False)
class PoseEffects:
    """How effects of the poses reach residuals and estimate; E effects, n parameters."""

    scores: Floats  # (E,) weighted products of the effects' derivatives, in 1/px, and the residuals
    # (E, E) derivatives of the scores by the effects; the scores' covariance if there are none
    information: Floats
    passed: Floats  # (n, E) derivatives of the estimate by the effects
    device: NDArray[np.intp]  # (E,) 0 for effects on the camera's points, 1 on the projector's
    leaked: Floats  # (2, E) squares in the board's residuals, within its plane and out of it, by effect

    @property
    def groups(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows of the effects on the camera's points and on the projector's."""
        return np.flatnonzero(self.device == 0), np.flatnonzero(self.device == 1)

    def without(self, rows: NDArray[np.intp]) -> PoseEffects:
        remaining = np.delete(np.arange(len(self.scores)), rows)
        return PoseEffects(
            self.scores[remaining],
            self.information[np.ix_(remaining, remaining)],
            self.passed[:, remaining],
            self.device[remaining],
            self.leaked[:, remaining],
        )

    def variances(self) -> tuple[Floats, Floats]:
        """Estimate the variance of the effects in each device by the method of moments."""
        # returns variances (2,), uncertainties (2,)
        groups = self.groups
        squares = np.array(
            [np.sum(self.scores[g] ** 2) - np.trace(self.information[np.ix_(g, g)]) for g in groups]
        )
        design = np.array([[np.sum(self.information[np.ix_(g, h)] ** 2) for h in groups] for g in groups])
        scale = 1.0 / np.sqrt(np.diag(design))
        scaled, _ = nnls(design * np.outer(scale, scale), squares * scale)
        variances = scaled * scale
        spread = self.information + self.information * variances[self.device] @ self.information
        noise = np.array([[2.0 * np.sum(spread[np.ix_(g, h)] ** 2) for h in groups] for g in groups])
        inverse = np.linalg.inv(design)
        return variances, np.sqrt(np.diag(inverse @ noise @ inverse.T))


@dataclass(frozen=True)
class PoseShift:
    """How far the projector's coordinates of a whole pose are shifted, and how rarely chance does so."""

    shift_px: float  # length of the shift in px of the projector
    chance: float  # probability of a shift as clear as this one


def pose_shifts(effects: PoseEffects) -> list[PoseShift]:
    """Estimate by how much the board of each pose moved between its image and its fringes."""
    shifts, size = [], 4 * FUNCTIONS
    for pose in range(len(effects.scores) // size):
        own = np.arange(pose * size, (pose + 1) * size)
        variances, _ = effects.without(own).variances()
        shift = own[[2 * FUNCTIONS, 3 * FUNCTIONS]]
        information = effects.information[np.ix_(shift, shift)]
        expected = (
            information
            + effects.information[shift] * variances[effects.device] @ effects.information[:, shift]
        )
        score = effects.scores[shift]
        square = float(score @ np.linalg.solve(expected, score))
        shifts.append(
            PoseShift(float(np.linalg.norm(np.linalg.solve(information, score))), float(chi2.sf(square, 2)))
        )
    return shifts


def pose_effects(problem: Problem, vector: Floats, inverse: Floats, limit: float) -> PoseEffects:
    """Compute how effects of the poses reach the residuals of a fit and the estimate."""
    # vector (n,); inverse (n, n)
    solution = problem.unpack(vector)
    columns, scores, own = [], [], []
    for index in range(len(problem.observations)):
        basis = effects_of_pose(problem, index, solution)
        residuals, weight = problem.weighted_residuals(index, solution, limit)
        scores.append(basis.T @ (weight * residuals))
        own.append(basis.T @ (weight[:, None] * basis))
        columns.append(problem.transposed(index, solution, weight[:, None] * basis))
    through = np.hstack(columns)
    passed = -inverse @ through
    effects = len(problem.observations) * 4 * FUNCTIONS
    device = np.arange(effects) // (2 * FUNCTIONS) % 2
    places, _, sigmas = problem.priors
    leaked = [np.sum((passed[places[rows]] / sigmas[rows, None]) ** 2, axis=0) for rows in problem.board_rows]
    return PoseEffects(
        np.concatenate(scores),
        block_diag(*own) + through.T @ passed,
        passed,
        device,
        np.array(leaked),
    )


def effects_of_pose(problem: Problem, index: int, solution: Solution) -> Floats:
    """Differentiate the whitened residuals of a pose by its effects."""
    # returns (4 K, 24)
    functions = smooth_functions(problem.model.drawn[problem.observations[index].ids, :2])
    rows = np.zeros((2, len(functions), 2, 2, 2, FUNCTIONS))
    for device in (0, 1):
        for coordinate in (0, 1):
            rows[device, :, coordinate, device, coordinate] = functions
    return problem.whitened(index, rows.reshape(4 * len(functions), -1), solution.carried)


def rough_residuals(
    problem: Problem, vector: Floats, inverse: Floats
) -> tuple[tuple[Floats, Floats], tuple[float, float]]:
    """Take the smooth functions of each pose from its whitened residuals."""
    # returns residuals of camera and projector, and the expected sums of their squares
    solution, every = problem.unpack(vector), np.eye(len(vector))
    rough, free = [], np.zeros(2)
    for index in range(len(problem.observations)):
        smooth, _ = np.linalg.qr(effects_of_pose(problem, index, solution))
        residuals, _ = problem.weighted_residuals(index, solution, np.inf)
        slopes = problem.whitened_residual_changes(index, solution, every)
        slopes -= smooth @ (smooth.T @ slopes)
        used = np.sum((slopes @ inverse) * slopes, axis=1) + np.sum(smooth**2, axis=1)
        free += [half.size - half.sum() for half in np.split(used, 2)]
        rough.append(np.split(residuals - smooth @ (smooth.T @ residuals), 2))
    camera, projector = (np.concatenate(parts) for parts in zip(*rough, strict=True))
    return (camera, projector), (float(free[0]), float(free[1]))


def widened_variances(variances: Floats, uncertainties: Floats) -> Floats:
    """Compute the expected variances, given uncertain estimates of them."""
    at = variances / uncertainties
    return np.asarray(variances + uncertainties * np.exp(norm.logpdf(at) - norm.logcdf(at)))
