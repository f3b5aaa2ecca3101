"""The least-squares problem of the joint adjustment: whitened residuals and their normal equations.

A point's coordinate in the projector is read at the pixel where the camera detects the point, so that part
of the detection error is carried into it: with A the derivative of projector by camera coordinates over the
board, and κ the share that is carried, the projector's residual less κ A times the camera's is independent
of the camera's. Each residual is divided by the standard deviation of its kind.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import INTRINSICS
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import (
    ErrorSizes,
    Model,
    Solution,
    compose_with_derivatives,
    project_with_derivatives,
)
from fpplab.core.compiled import kernel
from fpplab.core.conventions import Floats
from fpplab.core.robust import huber_weights

DISTORTION_SHARES = {"k1": (0.3, 2), "k2": (0.1, 4), "p1": (0.01, 1), "p2": (0.01, 1), "k3": (0.05, 6)}
"""Prior standard deviation of each term's distortion about zero, as a share of the radius at the image's
corner, and the power of that radius in it. They are several times the distortion of camera and projector
lenses, and only limit combinations of terms that the points do not determine.

Those of k4, k5, k6 are 1, since wide lenses need them of order one. On a lens of little distortion k1, k2, k3
compensate them, and without the prior all would grow together until a pole of the model, cancelled at the
points by a zero of the numerator, lies in the image."""


@dataclass(frozen=True, eq=False)
class Problem:
    """The least-squares problem: parameters packed in one vector, residuals and normal equations.

    The vector holds the camera's estimated intrinsics, the projector's, T_projector_camera, the share that
    is carried, the poses, where the board is refined its points, and the steps of the projector's drift.
    """

    observations: tuple[Observation, ...]  # the poses
    model: Model  # which parameters are estimated
    sizes: ErrorSizes  # by which residuals are weighted
    near: Solution  # where the derivatives by the detection error are taken

    @property
    def _free(self) -> int:
        return len(self.model.level.terms)

    @property
    def vector_offsets(self) -> tuple[int, int, int, int, int]:
        """Where projector, T_projector_camera, share carried, poses and board begin in the vector."""
        n = self._free
        return n, 2 * n, 2 * n + 6, 2 * n + 7, 2 * n + 7 + 6 * len(self.observations)

    @property
    def _steps_from(self) -> int:
        return self.vector_offsets[-1] + self.model.refined * self.model.drawn.size

    @property
    def length(self) -> int:
        return self._steps_from + self.near.steps.size

    @property
    def priors(self) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Indices (Q,) of the parameters that have a prior, its means and its standard deviations."""
        n, (_, _, carried, _, board) = self._free, self.vector_offsets
        lenses = np.concatenate([np.arange(4, n), n + np.arange(4, n)])
        sigmas = [*self._lens_priors, 1.0]  # the share carried is 0 to 1
        index = np.append(lenses, carried)
        walked = np.arange(self._steps_from, self.length)
        index, sigmas = np.append(index, walked), sigmas + [self.sizes.drift_px] * len(walked)
        if not self.model.refined:
            return index, np.zeros(len(index)), np.array(sigmas)
        of_board = (self.sizes.in_plane_mm, self.sizes.in_plane_mm, self.sizes.out_of_plane_mm)
        drawn = self.model.drawn.ravel()
        return (
            np.concatenate([index, np.arange(board, board + len(drawn))]),
            np.concatenate([np.zeros(len(index)), drawn]),
            np.concatenate([sigmas, np.tile(of_board, len(drawn) // 3)]),
        )

    @cached_property
    def _lens_priors(self) -> list[float]:
        """Standard deviations of the distortion coefficients of camera and projector."""
        sigmas = []
        for device, size in zip(("camera", "projector"), self.model.image_sizes or (None, None), strict=True):
            lens = getattr(self.near, device)
            pixels = np.concatenate([getattr(o, f"{device}_px") for o in self.observations])
            if size is not None:
                corners = np.array(list(product((0.0, size[0] - 1.0), (0.0, size[1] - 1.0))))
                pixels = np.concatenate([pixels, corners])
            radius = float(np.hypot(*((pixels - lens[2:4]) / lens[:2]).T).max())
            for term in self.model.level.terms[4:]:
                share, power = DISTORTION_SHARES.get(term, (1.0, 0))
                sigmas.append(share / radius**power)
        return sigmas

    @cached_property
    def _carry(self) -> list[Floats]:
        """By pose: A (K, 2, 2)."""
        carries = []
        for index, observation in enumerate(self.observations):
            *_, by_point = pose_slopes(self.near, index, observation, self._free)
            camera, projector = by_point.reshape(2, -1, 2, 3)
            (a, b), (c, d) = np.moveaxis(camera[..., :2], 0, -1)
            adjugate = np.moveaxis(np.array([[d, -b], [-c, a]]), -1, 0)
            carries.append(projector[..., :2] @ adjugate / (a * d - b * c)[:, None, None])
        return carries

    @property
    def board_rows(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which rows (Q,) of `priors` are of the board's points within its plane, and out of it."""
        place, board = self.priors[0], self.vector_offsets[-1]
        axis = (place - board) % 3
        of_board = (place >= board) & (place < self._steps_from)
        return of_board & (axis < 2), of_board & (axis == 2)

    def pack(self, solution: Solution) -> Floats:
        # returns (n,)
        n = self._free
        parts = [
            solution.camera[:n],
            solution.projector[:n],
            solution.T_projector_camera,
            np.array([solution.carried]),
            solution.poses.ravel(),
        ]
        if self.model.refined:
            parts.append(solution.board.ravel())
        parts.append(solution.steps.ravel())
        return np.concatenate(parts)

    def unpack(self, vector: Floats) -> Solution:
        # vector (n,)
        projector, pair, carried, poses, board = self.vector_offsets
        held, steps = np.zeros(len(INTRINSICS) - self._free), self._steps_from
        return Solution(
            np.append(vector[:projector], held),
            np.append(vector[projector:pair], held),
            vector[pair:carried],
            vector[poses:board].reshape(-1, 6),
            vector[board:steps].reshape(-1, 3) if self.model.refined else self.model.drawn,
            float(vector[carried]),
            vector[steps:].reshape(-1, 2),
            self.near.ages,
        )

    def _raw(self, index: int, solution: Solution) -> Floats:
        """Residuals (4 K,) of one pose in px."""
        return np.concatenate(solution.residuals(index, self.observations[index])).ravel()

    def weighted_residuals(self, index: int, solution: Solution, limit: float) -> tuple[Floats, Floats]:
        """Compute the whitened residuals of one pose with their weights."""
        # returns residuals (4 K,), weight (4 K,)
        raw = self._raw(index, solution)
        residuals = self.whitened(index, raw, solution.carried)
        residuals[np.isnan(raw)] = 0.0  # of a coordinate that was not coded
        return residuals, huber_weights(residuals, 1.0, limit)

    def transposed(self, index: int, solution: Solution, rows: Floats) -> Floats:
        """Multiply rows of one pose by the transposed derivatives of its whitened residuals."""
        # rows (4 K, E); returns (n, E)
        columns, slopes, by_point = self.slopes(index, solution)
        product = np.zeros((self.length, rows.shape[1]))
        product[columns] = slopes.T @ rows
        if self.model.refined:
            shape = (2, len(by_point) // 4, 2)
            product[self._own(index)] = np.einsum(
                "dkui,dkue->kie", by_point.reshape(*shape, 3), rows.reshape(*shape, -1)
            )
        return product

    def whitened_residual_changes(self, pose: int, solution: Solution, parameter_changes: Floats) -> Floats:
        """Compute how changes of the parameters change the whitened residuals of one pose, to first order."""
        # parameter_changes (n, E); returns (4 K, E)
        columns, slopes, by_point = self.slopes(pose, solution)
        product = slopes @ parameter_changes[columns]
        if self.model.refined:
            shape = (2, len(by_point) // 4, 2)
            moved = np.einsum(
                "dkui,kie->dkue", by_point.reshape(*shape, 3), parameter_changes[self._own(pose)]
            )
            product += moved.reshape(product.shape)
        return np.asarray(product)

    def _own(self, index: int) -> NDArray[np.intp]:
        """Where the points (K, 3) of a pose are in the vector."""
        return np.asarray(self.vector_offsets[-1] + 3 * self.observations[index].ids[:, None] + np.arange(3))

    def whitened(self, pose_index: int, residual_rows: Floats, camera_error_share: float) -> Floats:
        """Make residuals of one pose independent of one another and of unit variance."""
        shape = residual_rows.shape
        camera, projector = residual_rows.reshape(2, shape[0] // 4, 2, -1)
        projector = projector - camera_error_share * (self._carry[pose_index] @ camera)
        whole = np.stack([camera / self.sizes.camera_px, projector / self.sizes.projector_px])
        return np.asarray(whole.reshape(shape))

    def unwhitened(self, pose_index: int, whitened_rows: Floats, camera_error_share: float) -> Floats:
        shape = whitened_rows.shape
        camera, projector = whitened_rows.reshape(2, shape[0] // 4, 2, -1)
        camera = camera * self.sizes.camera_px
        projector = projector * self.sizes.projector_px + camera_error_share * (
            self._carry[pose_index] @ camera
        )
        return np.asarray(np.stack([camera, projector]).reshape(shape))

    def errors(self, vector: Floats) -> tuple[Floats, Floats]:
        # vector (n,); returns camera (R,), projector (R,)
        solution = self.unpack(vector)
        pairs = [
            np.split(self.weighted_residuals(i, solution, np.inf)[0], 2)
            for i in range(len(self.observations))
        ]
        cameras, projectors = zip(*pairs, strict=True)
        return np.concatenate(cameras), np.concatenate(projectors)

    def misfit(self, vector: Floats) -> Floats:
        # vector (n,); returns (R,)
        return np.concatenate([*self.errors(vector), self.prior_residuals(vector)])

    def prior_residuals(self, vector: Floats) -> Floats:
        """Compute the deviations from prior knowledge."""
        # vector (n,); returns (Q,)
        index, means, sigmas = self.priors
        return np.asarray((vector[index] - means) / sigmas)

    def normal_equations(self, vector: Floats, limit: float = np.inf) -> tuple[Floats, Floats]:
        # vector (n,); returns matrix (n, n), gradient (n,)
        solution = self.unpack(vector)
        matrix, gradient = np.zeros((len(vector), len(vector))), np.zeros(len(vector))
        for index in range(len(self.observations)):
            self._add_pose(matrix, gradient, index, solution, limit)
        with_prior, _, sigmas = self.priors
        prior_residuals = self.prior_residuals(vector)
        weight = huber_weights(prior_residuals, 1.0, limit) / sigmas
        matrix[with_prior, with_prior] += weight / sigmas
        gradient[with_prior] += weight * prior_residuals
        return matrix, gradient

    def pose_equations(self, index: int, vector: Floats, limit: float = np.inf) -> tuple[Floats, Floats]:
        """Build what one pose adds to the normal equations."""
        # vector (n,); returns matrix (n, n), gradient (n,)
        matrix, gradient = np.zeros((len(vector), len(vector))), np.zeros(len(vector))
        self._add_pose(matrix, gradient, index, self.unpack(vector), limit)
        return matrix, gradient

    def _add_pose(
        self, matrix: Floats, gradient: Floats, index: int, solution: Solution, limit: float
    ) -> None:  # fmt: skip
        raw, columns, slopes, by_point = self._linearised(index, solution)
        residuals = self.whitened(index, raw, solution.carried)
        weight = huber_weights(residuals, 1.0, limit)
        weighted = slopes * weight[:, None]
        matrix[np.ix_(columns, columns)] += slopes.T @ weighted
        gradient[columns] += weighted.T @ residuals
        if not self.model.refined:
            return
        add_points(matrix, gradient, columns, self._own(index), slopes, by_point, weight, residuals)

    def slopes(self, index: int, solution: Solution) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Differentiate the whitened residuals of one pose."""
        # returns columns (C,), slopes (4 K, C), by_point (4 K, 3)
        return self._linearised(index, solution)[1:]

    def _linearised(self, index: int, solution: Solution) -> tuple[Floats, NDArray[np.intp], Floats, Floats]:
        """Residuals (4 K,) of one pose in px, and what `slopes` returns."""
        _, _, carried, poses, _ = self.vector_offsets
        raw, pose, shared, by_point = pose_slopes(solution, index, self.observations[index], self._free)
        through = self._carry[index]
        by_carried = np.zeros((len(raw), 1))
        half = len(raw) // 2
        by_carried[half:, 0] = -(through @ raw[:half].reshape(-1, 2, 1)).ravel() / self.sizes.projector_px
        columns = [np.arange(carried), poses + 6 * index + np.arange(6), np.array([carried])]
        age = solution.ages[index] if len(solution.ages) else 0
        columns.append(np.arange(self.length - 2 * age, self.length))
        by_step = np.concatenate([np.zeros((half, 2 * age)), np.tile(-np.eye(2), (half // 2, age))])
        parts = [
            self.whitened(index, shared, solution.carried),
            self.whitened(index, pose, solution.carried),
            by_carried,
            self.whitened(index, by_step, solution.carried),
        ]
        by_point = self.whitened(index, by_point, solution.carried)
        slopes, uncoded = np.hstack(parts), np.isnan(raw)
        slopes[uncoded] = by_point[uncoded] = 0.0
        return raw, np.concatenate(columns).astype(np.intp), slopes, by_point


def without_poses(solution: Solution, held: Sequence[int] | int) -> Solution:
    ages = np.delete(solution.ages, held) if len(solution.ages) else solution.ages
    return replace(solution, poses=np.delete(solution.poses, held, axis=0), ages=ages)


@kernel(error_model="numpy")
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
