"""Bundle adjustment of camera, projector, the pose between them, and every pose of the board.

Both devices see the same points of the same board, so one least-squares problem contains all that is
known; it minimises the points' reprojection error in pixels, of both devices alike (Triggs et al.,
"Bundle adjustment: a modern synthesis", 2000). The normal equations are built block by block: the residuals
of a pose depend only on the devices, on the pose, and on the board's own points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.optimize import least_squares

from fpplab.calibration.model import INTRINSICS, POSE, Uncertainty
from fpplab.characterisation.observation import Observation
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import RigidTransform
from fpplab.core.robust import robust_spread

SOFT = 3.0
"""Residuals beyond this many robust standard deviations enter linearly, not squared (Huber)."""

RATIONAL_SIGMA = 1.0
"""Prior standard deviation of k4, k5, k6 about zero. Wide lenses need them of order one. On a lens of little
distortion k1, k2, k3 compensate them, and without the prior all would grow together until a pole of the
model, cancelled at the points by a zero of the numerator, lies in the image."""

LEAST_EIGENVALUE = 1e-13
"""Least significant eigenvalue of normal equations scaled to a diagonal of ones, relative to the greatest."""

UNDETERMINED = "the poses do not determine all parameters; add some that are tilted by 20° or more"
"""Message for poses that leave a parameter undetermined."""

MOST_DAMPING = 1e8
"""Damping at which the fit ends: no step reduces the residuals."""

ROUNDS = 3
"""Most iterations of the estimate of the noise; it usually converges in the second."""


class DistortionModel(StrEnum):
    """How many distortion coefficients are estimated, in both devices alike; the others are zero."""

    K1 = "k1"
    K2 = "k2"
    TANGENTIAL = "tangential"
    K3 = "k3"
    RATIONAL = "rational"

    @property
    def terms(self) -> tuple[str, ...]:
        """The intrinsic parameters that are free; the first of `INTRINSICS`."""
        return INTRINSICS[: {"k1": 5, "k2": 6, "tangential": 8, "k3": 9, "rational": 12}[self]]


@dataclass(frozen=True, eq=False)
class Solution:
    """All parameters that are adjusted.

    Attributes
    ----------
    camera : Floats
        (12,) as named in `INTRINSICS`.
    projector : Floats
        (12,) as named in `INTRINSICS`.
    T_projector_camera : Floats
        (6,) rotation vector in rad and translation in mm.
    poses : Floats
        (M, 6) `T_camera_target` of every pose: rotation vectors in rad and translations in mm.
    board : Floats
        (P, 3) points of the board in mm.
    """

    camera: Floats
    projector: Floats
    T_projector_camera: Floats
    poses: Floats
    board: Floats

    def residuals(self, index: int, observation: Observation) -> tuple[Floats, Floats]:
        """Compute the reprojection errors of one pose.

        Parameters
        ----------
        index : int
            Of the pose.
        observation : Observation
            What was measured in it.

        Returns
        -------
        camera : Floats
            (K, 2) model minus observation in px.
        projector : Floats
            (K, 2) model minus observation in px.
        """
        points, pose = self.board[observation.ids], self.poses[index]
        seen = _view(points, pose, self.camera)[0] - observation.camera_px
        chained, _ = _chain(pose, self.T_projector_camera)
        return seen, _view(points, chained, self.projector)[0] - observation.projector_px


@dataclass(frozen=True, eq=False)
class Model:
    """What is fitted to observations: the level of the distortion, and the board as it was drawn.

    Attributes
    ----------
    level : DistortionModel
        Which distortion coefficients are estimated.
    drawn : Floats
        (P, 3) points of the board as drawn, in mm.
    board_sigma_mm : float or None
        Standard deviation in mm of the board's points from there; None takes the board as exact.
    """

    level: DistortionModel
    drawn: Floats
    board_sigma_mm: float | None = None


def adjust_bundle(observations: Sequence[Observation], start: Solution, model: Model) -> Solution:
    """Find the best solution near a start, by a robust fit.

    Parameters
    ----------
    observations : Sequence[Observation]
        The poses.
    start : Solution
        Initial values.
    model : Model
        Which parameters are estimated.

    Returns
    -------
    Solution
        At the minimum of Huber's loss of the reprojection errors.

    Raises
    ------
    CalibrationError
        The poses do not determine all parameters.

    References
    ----------
    Triggs et al., "Bundle adjustment: a modern synthesis", 2000.
    """
    problem = Problem(tuple(observations), model, 1.0)
    vector = problem.pack(start)
    for _ in range(ROUNDS):
        noise = problem.spread(vector)
        settled = abs(noise - problem.noise_px) < 1e-3 * noise
        problem = replace(problem, noise_px=noise)
        if settled:
            break
        vector = _descend(problem, vector)
    return problem.unpack(vector)


def uncertainty(observations: Sequence[Observation], best: Solution, model: Model) -> Uncertainty:
    """Estimate the uncertainty of the devices and of the pose between them.

    The covariance is marginal: it contains the uncertainty of the poses and of the board.

    Parameters
    ----------
    observations : Sequence[Observation]
        The poses.
    best : Solution
        What `adjust_bundle` found for this model.
    model : Model
        Which parameters are estimated.

    Returns
    -------
    Uncertainty
        Covariance of the estimated parameters, from the scatter of the residuals.

    Raises
    ------
    CalibrationError
        The poses do not determine the parameters.
    """
    problem = Problem(tuple(observations), model, 1.0)
    vector = problem.pack(best)
    return replace(problem, noise_px=problem.spread(vector)).uncertainty(vector)


def _descend(problem: Problem, vector: Floats) -> Floats:
    """Minimise Huber's loss by Levenberg-Marquardt's method with reweighting."""
    limit, damping = SOFT * problem.noise_px, 1e-4
    cost = _huber(problem.misfit(vector), limit)
    for _ in range(200):
        normal, gradient = problem.normal_equations(vector, limit)
        normal[np.diag_indices_from(normal)] *= 1.0 + damping
        try:
            # NumPy's factorisation, not SciPy's, which spends 100 ms on waking threads for small matrices.
            trial = vector - cho_solve((np.linalg.cholesky(normal), True), gradient)
        except (np.linalg.LinAlgError, ValueError) as error:
            damping *= 10.0
            if damping > MOST_DAMPING:
                raise CalibrationError(UNDETERMINED) from error
            continue
        gain = cost - _huber(problem.misfit(trial), limit)
        if gain > 0:
            vector, cost, damping = trial, cost - gain, 0.1 * damping
        else:
            damping *= 10.0
        if abs(gain) <= 1e-9 * cost or damping > MOST_DAMPING:
            break
    return vector


def _huber(residuals: Floats, limit: float) -> float:
    size = np.abs(residuals)
    return float(np.sum(np.where(size <= limit, size**2, limit * (2 * size - limit))))


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


def vectors_of(transform: RigidTransform) -> Floats:
    """Write a rigid transform as six numbers.

    Parameters
    ----------
    transform : RigidTransform
        The transform.

    Returns
    -------
    Floats
        (6,) rotation vector in rad and translation in mm.
    """
    return np.concatenate([transform.rotation_vector, transform.translation])


@dataclass(frozen=True, eq=False)
class Problem:
    """The least-squares problem: parameters packed in one vector, residuals and normal equations.

    The vector holds the camera's estimated intrinsics, the projector's, T_projector_camera, the poses and,
    where the board is estimated too, its points.

    Attributes
    ----------
    observations : tuple[Observation, ...]
        The poses.
    model : Model
        Which parameters are estimated.
    noise_px : float
        Standard deviation of a pixel coordinate, which weights the points' errors against the board's.
    """

    observations: tuple[Observation, ...]
    model: Model
    noise_px: float

    @property
    def _free(self) -> int:
        return len(self.model.level.terms)

    @property
    def _heads(self) -> tuple[int, int, int, int]:
        """Where the projector, T_projector_camera, the poses and the board begin in the vector."""
        n = self._free
        return n, 2 * n, 2 * n + 6, 2 * n + 6 + 6 * len(self.observations)

    @property
    def _rational(self) -> NDArray[np.intp]:
        """Where k4, k5, k6 of both devices are in the vector, as far as they are estimated."""
        rational = np.arange(INTRINSICS.index("k4"), self._free)
        return np.concatenate([rational, self._free + rational])

    def pack(self, solution: Solution) -> Floats:
        """Pack the estimated parameters of a solution.

        Parameters
        ----------
        solution : Solution
            All parameters.

        Returns
        -------
        Floats
            (n,) the vector.
        """
        n = self._free
        parts = [
            solution.camera[:n],
            solution.projector[:n],
            solution.T_projector_camera,
            solution.poses.ravel(),
        ]
        if self.model.board_sigma_mm is not None:
            parts.append(solution.board.ravel())
        return np.concatenate(parts)

    def unpack(self, vector: Floats) -> Solution:
        """Unpack a vector of estimated parameters.

        Parameters
        ----------
        vector : Floats
            (n,) as from `pack`.

        Returns
        -------
        Solution
            With zero for the distortion coefficients that are not estimated.
        """
        projector, pair, poses, board = self._heads
        held = np.zeros(len(INTRINSICS) - self._free)
        return Solution(
            np.append(vector[:projector], held),
            np.append(vector[projector:pair], held),
            vector[pair:poses],
            vector[poses:board].reshape(-1, 6),
            self.model.drawn if self.model.board_sigma_mm is None else vector[board:].reshape(-1, 3),
        )

    def spread(self, vector: Floats) -> float:
        """Estimate the noise of the points robustly, from the median of the residuals' size.

        Parameters
        ----------
        vector : Floats
            (n,) parameters.

        Returns
        -------
        float
            Standard deviation of a pixel coordinate in px, at least 1e-6.
        """
        return robust_spread(self._errors(self.unpack(vector)), 1e-6)

    def misfit(self, vector: Floats) -> Floats:
        """Compute all residuals.

        Parameters
        ----------
        vector : Floats
            (n,) parameters.

        Returns
        -------
        Floats
            (R,) in px: reprojection errors, then deviations from prior knowledge, of which one standard
            deviation counts `noise_px`.
        """
        _, pulls, _ = self._known(vector)
        return np.concatenate([self._errors(self.unpack(vector)), pulls])

    def _known(self, vector: Floats) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Return the parameters with a prior: their indices, residuals in px, and derivatives of these."""
        rational = self._rational
        stiffness = np.full(len(rational), self.noise_px / RATIONAL_SIGMA)
        pulls = vector[rational] * stiffness
        if self.model.board_sigma_mm is None:
            return rational, pulls, stiffness
        board = np.arange(self._heads[3], len(vector))
        stiff = np.full(len(board), self.noise_px / self.model.board_sigma_mm)
        moved = vector[board] - self.model.drawn.ravel()
        return (
            np.concatenate([rational, board]),
            np.concatenate([pulls, moved * stiff]),
            np.concatenate([stiffness, stiff]),
        )

    def _errors(self, solution: Solution) -> Floats:
        pairs = [solution.residuals(i, o) for i, o in enumerate(self.observations)]
        return np.concatenate([np.concatenate(pair).ravel() for pair in pairs])

    def normal_equations(self, vector: Floats, limit: float = np.inf) -> tuple[Floats, Floats]:
        """Build the normal equations of the residuals r with derivatives J.

        Parameters
        ----------
        vector : Floats
            (n,) parameters.
        limit : float
            Residuals beyond it, in px, get Huber's weight in W.

        Returns
        -------
        matrix : Floats
            `JᵀWJ`, (n, n).
        gradient : Floats
            `JᵀWr`, (n,).
        """
        solution = self.unpack(vector)
        matrix, gradient = np.zeros((len(vector), len(vector))), np.zeros(len(vector))
        for index, observation in enumerate(self.observations):
            self._add_pose(matrix, gradient, index, observation, solution, limit)
        known, pulls, stiffness = self._known(vector)
        weight = stiffness * _weight(pulls, limit)
        matrix[known, known] += weight * stiffness
        gradient[known] += weight * pulls
        return matrix, gradient

    def _add_pose(
        self,
        matrix: Floats,
        gradient: Floats,
        index: int,
        observation: Observation,
        solution: Solution,
        limit: float,
    ) -> None:
        residuals = np.concatenate(solution.residuals(index, observation)).ravel()
        columns, slopes, by_point = self._pose_slopes(index, observation, solution)
        weight = _weight(residuals, limit)
        weighted = slopes * weight[:, None]
        matrix[np.ix_(columns, columns)] += slopes.T @ weighted
        gradient[columns] += weighted.T @ residuals
        if self.model.board_sigma_mm is None:
            return
        # Rows lie by device, point and coordinate; every point has its own three columns.
        shape = (2, len(observation.ids), 2)
        points = by_point.reshape(*shape, 3)
        heavy = (by_point * weight[:, None]).reshape(*shape, 3)
        own = self._heads[3] + 3 * observation.ids[:, None] + np.arange(3)
        shared = np.einsum("dkui,dkuc->kic", heavy, slopes.reshape(*shape, -1))
        matrix[own[:, :, None], own[:, None, :]] += np.einsum("dkui,dkuj->kij", heavy, points)
        matrix[own[:, :, None], columns[None, None, :]] += shared
        matrix[columns[None, :, None], own[:, None, :]] += shared.transpose(0, 2, 1)
        gradient[own] += np.einsum("dkui,dku->ki", heavy, residuals.reshape(shape))

    def _pose_slopes(
        self, index: int, observation: Observation, solution: Solution
    ) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Differentiate the residuals (R,) of one pose.

        Returns the indices (C,) of the parameters that they all depend on, the derivatives by these (R, C),
        and by the board's points, each residual by its own point (R, 3).
        """
        n, (_, pair, poses, _) = self._free, self._heads
        columns = np.append(np.arange(poses), poses + 6 * index + np.arange(6))
        points, pose = solution.board[observation.ids], solution.poses[index]
        chained, (by_pose, by_pair) = _chain(pose, solution.T_projector_camera)
        _, seen = _view(points, pose, solution.camera)
        _, projected = _view(points, chained, solution.projector)
        rows = len(seen)
        slopes = np.zeros((2 * rows, len(columns)))
        slopes[:rows, :n], slopes[:rows, -6:] = seen[:, 6 : 6 + n], seen[:, :6]
        slopes[rows:, n:pair] = projected[:, 6 : 6 + n]
        slopes[rows:, pair:poses] = projected[:, :6] @ by_pair
        slopes[rows:, -6:] = projected[:, :6] @ by_pose
        # Moving a point by δ moves it by R δ in the device's frame, as a translation would.
        by_point = [
            part[:, 3:6] @ cv2.Rodrigues(at[:3])[0] for part, at in ((seen, pose), (projected, chained))
        ]
        return columns, slopes, np.concatenate(by_point)

    def uncertainty(self, vector: Floats) -> Uncertainty:
        """Estimate the covariance of the devices and the pose between them from the scatter of the residuals.

        Parameters
        ----------
        vector : Floats
            (n,) parameters at the minimum.

        Returns
        -------
        Uncertainty
            Of the estimated parameters.

        Raises
        ------
        CalibrationError
            A parameter is not determined.
        """
        residuals, (normal, _) = self.misfit(vector), self.normal_equations(vector)
        scale = np.sqrt(np.diag(normal))
        if np.any(scale == 0):
            raise CalibrationError(UNDETERMINED)
        scaled = normal / np.outer(scale, scale)
        # k4, k5, k6 of a lens may be undetermined by any poses; all other parameters must be determined.
        others = np.delete(np.arange(len(vector)), self._rational)
        poses = np.linalg.eigvalsh(scaled[np.ix_(others, others)])
        if poses[0] < LEAST_EIGENVALUE * poses[-1]:
            raise CalibrationError(UNDETERMINED)
        values, vectors = np.linalg.eigh(scaled)
        inverse = (vectors / np.maximum(values, LEAST_EIGENVALUE * values[-1])) @ vectors.T
        spread = np.sum(residuals**2) / max(len(residuals) - len(vector), 1)
        shared = slice(self._heads[2])
        covariance = spread * inverse[shared, shared] / np.outer(scale[shared], scale[shared])
        terms = [f"{d}.{term}" for d in ("camera", "projector") for term in self.model.level.terms]
        names = (*terms, *(f"T_projector_camera.{term}" for term in POSE))
        return Uncertainty(names, 0.5 * (covariance + covariance.T))


def _weight(residuals: Floats, limit: float) -> Floats:
    """Return Huber's weights: 1 up to `limit`, then falling as 1/r."""
    if not np.isfinite(limit):
        return np.ones_like(residuals)
    return np.asarray(limit / np.maximum(np.abs(residuals), limit))


def _view(points: Floats, pose: Floats, intrinsics: Floats) -> tuple[Floats, Floats]:
    """Project points: pixels (K, 2), and derivatives (2 K, 18) by rotation, translation, `INTRINSICS`."""
    fx, fy, cx, cy = intrinsics[:4]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    pixels, slopes = cv2.projectPoints(points, pose[:3], pose[3:], matrix, intrinsics[4:])
    return np.asarray(pixels, np.float64).reshape(-1, 2), np.asarray(slopes, np.float64)


def _chain(pose: Floats, pair: Floats) -> tuple[Floats, tuple[Floats, Floats]]:
    """Return `pair @ pose` as (6,), with its derivatives (6, 6) by `pose` and by `pair`."""
    out = cv2.composeRT(pose[:3], pose[3:], pair[:3], pair[3:])
    rotation, translation, r_r1, r_t1, r_r2, r_t2, t_r1, t_t1, t_r2, t_t2 = out
    by_pose = np.block([[r_r1, r_t1], [t_r1, t_t1]])
    by_pair = np.block([[r_r2, r_t2], [t_r2, t_t2]])
    return np.concatenate([rotation.ravel(), translation.ravel()]), (by_pose, by_pair)
