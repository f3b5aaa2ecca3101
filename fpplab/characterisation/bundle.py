"""Joint adjustment of camera, projector, the pose between them, and every pose of the board.

Both devices see the same points of the same board, so one least-squares problem holds all that is
known; it uses the points' error in pixels, of both devices alike (bundle adjustment, Triggs et al.,
"Bundle adjustment: a modern synthesis", 2000).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.linalg import pinvh
from scipy.optimize import least_squares

from fpplab.characterisation.observation import Observation
from fpplab.conventions import Floats
from fpplab.errors import CalibrationError
from fpplab.geometry import RigidTransform

INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
SOFT = 3.0
"""Residuals beyond this many robust standard deviations count linearly, not squared (Huber)."""

UNDETERMINED = "the poses do not determine all parameters; add some that are tilted by 20° or more"

ROUNDS = 3
"""How often the noise is judged anew; it settles at the second."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Everything that is adjusted.

    camera, projector: (9,) as named in `INTRINSICS`. T_projector_camera, poses: (6,), (M, 6)
    rotation vectors in rad and translations in mm; poses are `T_camera_target`.
    board: (P, 3) points of the board in mm.
    """

    camera: Floats
    projector: Floats
    T_projector_camera: Floats
    poses: Floats
    board: Floats

    def residuals(self, index: int, observation: Observation) -> tuple[Floats, Floats]:
        """Model minus observation in px of one pose, for the camera and the projector, (K, 2) each."""
        points, pose = self.board[observation.ids], self.poses[index]
        seen = _view(points, pose, self.camera)[0] - observation.camera_px
        chained, _ = _chain(pose, self.T_projector_camera)
        return seen, _view(points, chained, self.projector)[0] - observation.projector_px


def adjust(
    observations: Sequence[Observation], start: Solution, k3: bool, board_sigma_mm: float | None = None
) -> tuple[Solution, Floats]:
    """The best solution near `start`, and the standard uncertainties in the order of `Problem.pack`.

    k3: whether the third radial term is free (it is held at its start otherwise).
    board_sigma_mm: how far the board's points may lie from where `start` has them, one standard
    deviation; None holds the board as it is.
    Raises `CalibrationError` when the poses do not determine the parameters.
    """
    problem = Problem(tuple(observations), start, k3, board_sigma_mm, 1.0)
    vector = problem.pack(start)
    for _ in range(ROUNDS):
        problem = replace(problem, noise_px=problem.spread(vector))
        vector = _descend(problem, vector)
    return problem.unpack(vector), problem.uncertainty(vector)


def _descend(problem: Problem, vector: Floats) -> Floats:
    """Levenberg-Marquardt's method on Huber's loss, by reweighting."""
    limit, damping = SOFT * problem.noise_px, 1e-4
    residuals = problem.misfit(vector)
    cost = _huber(residuals, limit)
    for _ in range(200):
        slopes = problem.slopes(vector)
        weighted = (slopes * np.minimum(1.0, limit / np.maximum(np.abs(residuals), limit))[:, None]).T
        normal, gradient = weighted @ slopes, weighted @ residuals
        normal[np.diag_indices_from(normal)] *= 1.0 + damping
        try:
            trial = vector - np.linalg.solve(normal, gradient)
        except np.linalg.LinAlgError as error:
            raise CalibrationError(UNDETERMINED) from error
        trial_residuals = problem.misfit(trial)
        gain = cost - _huber(trial_residuals, limit)
        if gain > 0:
            vector, residuals, cost, damping = trial, trial_residuals, cost - gain, 0.1 * damping
        else:
            damping *= 10.0
        if abs(gain) <= 1e-9 * cost or damping > 1e8:
            break
    return vector


def _huber(residuals: Floats, limit: float) -> float:
    size = np.abs(residuals)
    return float(np.sum(np.where(size <= limit, size**2, limit * (2 * size - limit))))


def fit_pose(observation: Observation, solution: Solution, start: Floats) -> Floats:
    """The pose (6,) of the board in one capture, all else held."""

    def misfit(pose: Floats) -> Floats:
        pair = replace(solution, poses=pose[None]).residuals(0, observation)
        return np.concatenate(pair).ravel()

    return np.asarray(least_squares(misfit, start, x_scale="jac", method="lm").x)


def vectors_of(transform: RigidTransform) -> Floats:
    """A rigid transform as (6,): rotation vector in rad and translation in mm."""
    return np.concatenate([transform.rotation_vector, transform.translation])


@dataclass(frozen=True, eq=False)
class Problem:
    """The least-squares problem: parameters packed in one vector, misfit and its slopes.

    The vector holds the camera's intrinsics, the projector's, T_projector_camera, the poses and,
    where the board is free, its points. noise_px: standard deviation of a pixel coordinate, which
    weighs the points' errors against the board's.
    """

    observations: tuple[Observation, ...]
    start: Solution
    k3: bool
    board_sigma_mm: float | None
    noise_px: float

    @property
    def _free(self) -> int:
        return len(INTRINSICS) if self.k3 else len(INTRINSICS) - 1

    @property
    def _heads(self) -> tuple[int, int, int, int]:
        """Where the projector, T_projector_camera, the poses and the board begin."""
        n = self._free
        return n, 2 * n, 2 * n + 6, 2 * n + 6 + 6 * len(self.observations)

    def pack(self, solution: Solution) -> Floats:
        n = self._free
        parts = [
            solution.camera[:n],
            solution.projector[:n],
            solution.T_projector_camera,
            solution.poses.ravel(),
        ]
        if self.board_sigma_mm is not None:
            parts.append(solution.board.ravel())
        return np.concatenate(parts)

    def unpack(self, vector: Floats) -> Solution:
        projector, pair, poses, board = self._heads
        held = slice(self._free, None)
        return Solution(
            np.append(vector[:projector], self.start.camera[held]),
            np.append(vector[projector:pair], self.start.projector[held]),
            vector[pair:poses],
            vector[poses:board].reshape(-1, 6),
            self.start.board if self.board_sigma_mm is None else vector[board:].reshape(-1, 3),
        )

    def spread(self, vector: Floats) -> float:
        """Robust standard deviation of the points' errors in px; a trace above nothing."""
        errors = self._errors(self.unpack(vector))
        return max(1.4826 * float(np.median(np.abs(errors))), 1e-6)

    def misfit(self, vector: Floats) -> Floats:
        """Residuals in px; the board's deviations count as errors of `noise_px` for one deviation."""
        solution = self.unpack(vector)
        errors = self._errors(solution)
        if self.board_sigma_mm is None:
            return errors
        deviation = (solution.board - self.start.board).ravel()
        return np.concatenate([errors, deviation * (self.noise_px / self.board_sigma_mm)])

    def _errors(self, solution: Solution) -> Floats:
        pairs = [solution.residuals(i, o) for i, o in enumerate(self.observations)]
        return np.concatenate([np.concatenate(pair).ravel() for pair in pairs])

    def slopes(self, vector: Floats) -> Floats:
        """Derivative of `misfit`, (residuals, parameters)."""
        solution = self.unpack(vector)
        blocks = [self._pose_slopes(i, o, solution, len(vector)) for i, o in enumerate(self.observations)]
        if self.board_sigma_mm is not None:
            count = solution.board.size
            prior = np.zeros((count, len(vector)))
            prior[:, -count:] = np.eye(count) * (self.noise_px / self.board_sigma_mm)
            blocks.append(prior)
        return np.concatenate(blocks)

    def _pose_slopes(self, index: int, observation: Observation, solution: Solution, width: int) -> Floats:
        n = self._free
        projector, pair, poses, board = self._heads
        rows = 2 * len(observation.ids)
        block = np.zeros((2 * rows, width))
        points, pose = solution.board[observation.ids], solution.poses[index]
        chained, (by_pose, by_pair) = _chain(pose, solution.T_projector_camera)
        own = slice(poses + 6 * index, poses + 6 * index + 6)
        _, slopes = _view(points, pose, solution.camera)
        block[:rows, own], block[:rows, :n] = slopes[:, :6], slopes[:, 6 : 6 + n]
        _, chained_slopes = _view(points, chained, solution.projector)
        block[rows:, own] = chained_slopes[:, :6] @ by_pose
        block[rows:, pair : pair + 6] = chained_slopes[:, :6] @ by_pair
        block[rows:, projector : projector + n] = chained_slopes[:, 6 : 6 + n]
        if self.board_sigma_mm is not None:
            for top, part, frame in ((0, slopes, pose), (rows, chained_slopes, chained)):
                # Moving a point by δ moves it by R δ in the device's frame, as a translation would.
                by_point = part[:, 3:6] @ cv2.Rodrigues(frame[:3])[0]
                row, column = np.indices(by_point.shape)
                block[top + row, board + 3 * observation.ids[row // 2] + column] = by_point
        return block

    def uncertainty(self, vector: Floats) -> Floats:
        """Standard uncertainty of every parameter, from the spread of the residuals.

        Raises `CalibrationError` when a parameter could take any value.
        """
        residuals, slopes = self.misfit(vector), self.slopes(vector)
        scale = np.linalg.norm(slopes, axis=0)
        inverse, rank = pinvh((slopes / scale).T @ (slopes / scale), rtol=1e-13, return_rank=True)
        if rank < len(vector):
            raise CalibrationError(UNDETERMINED)
        spread = np.sum(residuals**2) / max(len(residuals) - len(vector), 1)
        return np.asarray(np.sqrt(spread * np.diag(inverse)) / scale)


def _view(points: Floats, pose: Floats, intrinsics: Floats) -> tuple[Floats, Floats]:
    """Pixels (K, 2) and their slopes (2 K, 15): by rotation, translation, and `INTRINSICS`."""
    fx, fy, cx, cy = intrinsics[:4]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    pixels, slopes = cv2.projectPoints(points, pose[:3], pose[3:], matrix, intrinsics[4:])
    return np.asarray(pixels, np.float64).reshape(-1, 2), np.asarray(slopes, np.float64)


def _chain(pose: Floats, pair: Floats) -> tuple[Floats, tuple[Floats, Floats]]:
    """`pair @ pose` as (6,), with its slopes (6, 6) by `pose` and by `pair`."""
    out = cv2.composeRT(pose[:3], pose[3:], pair[:3], pair[3:])
    rotation, translation, r_r1, r_t1, r_r2, r_t2, t_r1, t_t1, t_r2, t_t2 = out
    by_pose = np.block([[r_r1, r_t1], [t_r1, t_t1]])
    by_pair = np.block([[r_r2, r_t2], [t_r2, t_t2]])
    return np.concatenate([rotation.ravel(), translation.ravel()]), (by_pose, by_pair)
