"""Derivatives of one pose's residuals, and what they add to the normal equations."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import Solution, compose_with_derivatives, project_with_derivatives
from fpplab.core.conventions import Floats


@njit(cache=True, error_model="numpy")
def add_points(
    matrix: Floats,
    gradient: Floats,
    columns: NDArray[np.intp],
    own: NDArray[np.intp],
    slopes: Floats,
    by_point: Floats,
    weight: Floats,
    residuals: Floats,
) -> None:
    """Add to normal equations what the board's points of one pose contribute. Compiled."""
    # matrix (n, n); gradient (n,); columns (C,); own (K, 3); slopes (4 K, C); by_point (4 K, 3); weight (4
    # K,); residuals (4 K,)
    half = len(weight) // 2
    for k in range(len(own)):
        for row in (2 * k, 2 * k + 1, half + 2 * k, half + 2 * k + 1):
            for i in range(3):
                heavy = weight[row] * by_point[row, i]
                gradient[own[k, i]] += heavy * residuals[row]
                for j in range(3):
                    matrix[own[k, i], own[k, j]] += heavy * by_point[row, j]
                for c in range(len(columns)):
                    shared = heavy * slopes[row, c]
                    matrix[own[k, i], columns[c]] += shared
                    matrix[columns[c], own[k, i]] += shared


def pose_slopes(
    solution: Solution, index: int, observation: Observation, free: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Compute the residuals of one pose in px, and differentiate them."""
    # returns residuals (4 K,) px, by_pose (4 K, 6), shared (4 K, 2 free + 6), by_point (4 K, 3)
    points, pose = solution.board[observation.ids], solution.poses[index]
    chained, (by_pose, by_pair) = compose_with_derivatives(pose, solution.T_projector_camera)
    at_camera, imaged = project_with_derivatives(points, pose, solution.camera)
    at_projector, projected = project_with_derivatives(points, chained, solution.projector)
    at_projector += solution.shift_px(index)
    raw = np.concatenate([at_camera - observation.camera_px, at_projector - observation.projector_px])
    rows, n = len(imaged), free
    shared = np.zeros((2 * rows, 2 * n + 6))
    shared[:rows, :n] = imaged[:, 6 : 6 + n]
    shared[rows:, n : 2 * n] = projected[:, 6 : 6 + n]
    shared[rows:, 2 * n :] = projected[:, :6] @ by_pair
    own = np.concatenate([imaged[:, :6], projected[:, :6] @ by_pose])
    # Moving a point by δ moves it by R δ in the device's frame, as a translation would.
    by_point = [
        part[:, 3:6] @ cv2.Rodrigues(at[:3])[0] for part, at in ((imaged, pose), (projected, chained))
    ]
    return raw.ravel(), own, shared, np.concatenate(by_point)
