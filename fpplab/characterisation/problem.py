"""The least-squares problem of the joint adjustment: whitened residuals and their normal equations.

A point's coordinate in the projector is read at the pixel where the camera detects the point, so that part
of the detection error is carried into it: with A the derivative of projector by camera coordinates over the
board, and κ the share that is carried, the projector's residual less κ A times the camera's is independent
of the camera's. What the residuals of one pose share, because the board moved between the frames or bent, is
a random effect of that pose. Each residual is divided by the standard deviation of its kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import INTRINSICS
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import ErrorSizes, Model, Solution, chain, view
from fpplab.core.conventions import Floats

RATIONAL_SIGMA = 1.0
"""Prior standard deviation of k4, k5, k6 about zero. Wide lenses need them of order one. On a lens of little
distortion k1, k2, k3 compensate them, and without the prior all would grow together until a pole of the
model, cancelled at the points by a zero of the numerator, lies in the image."""

DISTORTION_SHARES = {"k1": (0.3, 2), "k2": (0.1, 4), "p1": (0.01, 1), "p2": (0.01, 1), "k3": (0.05, 6)}
"""Prior standard deviation of each term's distortion about zero, as a share of the radius of the outermost point,
and the power of that radius in it. They are several times the distortion of camera and projector lenses, and
only limit combinations of terms that the points do not determine."""

CARRIED_SIGMA = 1.0
"""Prior standard deviation about zero of the share of the detection error that is carried; it is 0 to 1."""

EFFECTS = 5
"""Number of effects of a pose: shifts of u and of v, and bending by x², xy, y²."""

SHIFTS = 2
"""How many of them are shifts; they come first."""


@dataclass(frozen=True, eq=False)
class Problem:
    """The least-squares problem: parameters packed in one vector, residuals and normal equations.

    The vector holds the camera's estimated intrinsics, the projector's, T_projector_camera, the share that
    is carried, the poses and, where the board is refined, the effects of the poses and its points.

    Attributes
    ----------
    observations : tuple[Observation, ...]
        The poses.
    model : Model
        Which parameters are estimated.
    sizes : ErrorSizes
        By which residuals are weighted.
    near : Solution
        Where the derivatives by effects of poses and by the detection error are taken.
    """

    observations: tuple[Observation, ...]
    model: Model
    sizes: ErrorSizes
    near: Solution

    @property
    def _free(self) -> int:
        return len(self.model.level.terms)

    @property
    def heads(self) -> tuple[int, int, int, int, int, int]:
        """Where projector, T_projector_camera, share carried, poses, effects and board begin in the vector."""
        n, m = self._free, len(self.observations)
        poses = 2 * n + 7
        effects = poses + 6 * m
        return n, 2 * n, 2 * n + 6, poses, effects, effects + EFFECTS * m * self.model.refined

    @property
    def priors(self) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Indices (Q,) of the parameters that have a prior, its means and its standard deviations."""
        n, (_, _, carried, _, effects, board) = self._free, self.heads
        lenses = np.concatenate([np.arange(4, n), n + np.arange(4, n)])
        sigmas = [*self._lens_priors, CARRIED_SIGMA]
        index = np.append(lenses, carried)
        if not self.model.refined:
            return index, np.zeros(len(index)), np.array(sigmas)
        shift, bent = self.sizes.shift_px, self.sizes.bent_mm
        of_board = (self.sizes.in_plane_mm, self.sizes.in_plane_mm, self.sizes.out_of_plane_mm)
        drawn = self.model.drawn.ravel()
        return (
            np.concatenate([index, np.arange(effects, board + len(drawn))]),
            np.concatenate([np.zeros(len(index) + board - effects), drawn]),
            np.concatenate(
                [
                    sigmas,
                    np.tile([shift] * SHIFTS + [bent] * (EFFECTS - SHIFTS), len(self.observations)),
                    np.tile(of_board, len(drawn) // 3),
                ]
            ),
        )

    @cached_property
    def _lens_priors(self) -> list[float]:
        """Standard deviations of the distortion coefficients of camera and projector."""
        sigmas = []
        for device in ("camera", "projector"):
            lens = getattr(self.near, device)
            pixels = np.concatenate([getattr(o, f"{device}_px") for o in self.observations])
            radius = float(np.hypot(*((pixels - lens[2:4]) / lens[:2]).T).max())
            for term in self.model.level.terms[4:]:
                share, power = DISTORTION_SHARES.get(term, (RATIONAL_SIGMA, 0))
                sigmas.append(share / radius**power)
        return sigmas

    @cached_property
    def _shared_errors(self) -> list[tuple[Floats, Floats]]:
        """By pose: A (K, 2, 2), and derivatives (4 K, 5) of the residuals by the effects of the pose."""
        half = 0.5 * float(np.ptp(self.model.drawn, axis=0).max())
        found = []
        for index, observation in enumerate(self.observations):
            _, _, by_point = _pose_slopes(self.near, index, observation, self._free)
            camera, projector = by_point.reshape(2, -1, 2, 3)
            carried = projector[..., :2] @ np.linalg.inv(camera[..., :2])
            x, y = self.model.drawn[observation.ids, :2].T / half
            bends = np.stack([x * x, x * y, y * y], axis=-1)
            effects = np.zeros((2, len(observation.ids), 2, EFFECTS))
            effects[1, :, 0, 0], effects[1, :, 1, 1] = 1.0, 1.0
            effects[0, ..., SHIFTS:] = camera[..., 2:] * bends[:, None, :]
            effects[1, ..., SHIFTS:] = projector[..., 2:] * bends[:, None, :]
            found.append((carried, effects.reshape(-1, EFFECTS)))
        return found

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
        n, m = self._free, len(self.observations)
        parts = [
            solution.camera[:n],
            solution.projector[:n],
            solution.T_projector_camera,
            [solution.carried],
            solution.poses.ravel(),
        ]
        if self.model.refined:
            effects = solution.pose_effects if len(solution.pose_effects) else np.zeros((m, EFFECTS))
            parts += [effects.ravel(), solution.board.ravel()]
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
        projector, pair, carried, poses, effects, board = self.heads
        held = np.zeros(len(INTRINSICS) - self._free)
        return Solution(
            np.append(vector[:projector], held),
            np.append(vector[projector:pair], held),
            vector[pair:carried],
            vector[poses:effects].reshape(-1, 6),
            vector[board:].reshape(-1, 3) if self.model.refined else self.model.drawn,
            float(vector[carried]),
            vector[effects:board].reshape(-1, EFFECTS),
        )

    def _raw(self, index: int, solution: Solution) -> Floats:
        """Residuals (4 K,) of one pose in px, with its effects."""
        residuals = np.concatenate(solution.residuals(index, self.observations[index])).ravel()
        if self.model.refined:
            residuals = residuals + self._shared_errors[index][1] @ solution.pose_effects[index]
        return residuals

    def _whitened(self, index: int, rows: Floats, carried: float) -> Floats:
        """Make rows (4 K, …), in px, independent of one another and of unit variance."""
        shape = rows.shape
        camera, projector = rows.reshape(2, shape[0] // 4, 2, -1)
        projector = projector - carried * (self._shared_errors[index][0] @ camera)
        whole = np.stack([camera / self.sizes.camera_px, projector / self.sizes.projector_px])
        return np.asarray(whole.reshape(shape))

    def errors(self, vector: Floats) -> tuple[Floats, Floats]:
        """Compute the whitened residuals of the points.

        Parameters
        ----------
        vector : Floats
            (n,) parameters.

        Returns
        -------
        camera : Floats
            (R,) in standard deviations.
        projector : Floats
            (R,) in standard deviations.
        """
        solution = self.unpack(vector)
        pairs = [
            np.split(self._whitened(i, self._raw(i, solution), solution.carried), 2)
            for i in range(len(self.observations))
        ]
        cameras, projectors = zip(*pairs, strict=True)
        return np.concatenate(cameras), np.concatenate(projectors)

    def misfit(self, vector: Floats) -> Floats:
        """Compute all residuals.

        Parameters
        ----------
        vector : Floats
            (n,) parameters.

        Returns
        -------
        Floats
            (R,) in standard deviations: the points' of the camera, of the projector, then deviations from
            prior knowledge.
        """
        return np.concatenate([*self.errors(vector), self.pulls(vector)])

    def pulls(self, vector: Floats) -> Floats:
        """Compute the deviations from prior knowledge.

        Parameters
        ----------
        vector : Floats
            (n,) parameters.

        Returns
        -------
        Floats
            (Q,) in standard deviations, in the order of `priors`.
        """
        index, means, sigmas = self.priors
        return np.asarray((vector[index] - means) / sigmas)

    def normal_equations(
        self, vector: Floats, limit: float = np.inf, camera_alone: bool = False
    ) -> tuple[Floats, Floats]:
        """Build the normal equations of the residuals r with derivatives J.

        Parameters
        ----------
        vector : Floats
            (n,) parameters.
        limit : float
            Residuals beyond it, in standard deviations, get Huber's weight in W.
        camera_alone : bool
            Whether only the camera's residuals contribute, without projector and priors.

        Returns
        -------
        matrix : Floats
            `JᵀWJ`, (n, n).
        gradient : Floats
            `JᵀWr`, (n,).
        """
        solution = self.unpack(vector)
        matrix, gradient = np.zeros((len(vector), len(vector))), np.zeros(len(vector))
        for index in range(len(self.observations)):
            self._add_pose(matrix, gradient, index, solution, limit, camera_alone)
        if not camera_alone:
            known, _, sigmas = self.priors
            pulls = self.pulls(vector)
            weight = huber_weight(pulls, limit) / sigmas
            matrix[known, known] += weight / sigmas
            gradient[known] += weight * pulls
        return matrix, gradient

    def _add_pose(
        self, matrix: Floats, gradient: Floats, index: int, solution: Solution, limit: float,
        camera_alone: bool,
    ) -> None:  # fmt: skip
        observation = self.observations[index]
        raw = self._raw(index, solution)
        residuals = self._whitened(index, raw, solution.carried)
        columns, slopes, by_point = self._slopes(index, solution, raw)
        weight = huber_weight(residuals, limit)
        if camera_alone:
            weight[len(weight) // 2 :] = 0.0
        weighted = slopes * weight[:, None]
        matrix[np.ix_(columns, columns)] += slopes.T @ weighted
        gradient[columns] += weighted.T @ residuals
        if not self.model.refined:
            return
        # Rows lie by device, point and coordinate; every point has its own three columns.
        shape = (2, len(observation.ids), 2)
        points = by_point.reshape(*shape, 3)
        heavy = (by_point * weight[:, None]).reshape(*shape, 3)
        own = self.heads[-1] + 3 * observation.ids[:, None] + np.arange(3)
        shared = np.einsum("dkui,dkuc->kic", heavy, slopes.reshape(*shape, -1))
        matrix[own[:, :, None], own[:, None, :]] += np.einsum("dkui,dkuj->kij", heavy, points)
        matrix[own[:, :, None], columns[None, None, :]] += shared
        matrix[columns[None, :, None], own[:, None, :]] += shared.transpose(0, 2, 1)
        gradient[own] += np.einsum("dkui,dku->ki", heavy, residuals.reshape(shape))

    def _slopes(
        self, index: int, solution: Solution, raw: Floats
    ) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Differentiate the whitened residuals (4 K,) of one pose.

        Returns the indices (C,) of the parameters that they all depend on, the derivatives by these (4 K, C),
        and by the board's points, each residual by its own point (4 K, 3).
        """
        _, _, carried, poses, effects, _ = self.heads
        pose, shared, by_point = _pose_slopes(solution, index, self.observations[index], self._free)
        through, by_effects = self._shared_errors[index]
        by_carried = np.zeros((len(raw), 1))
        half = len(raw) // 2
        by_carried[half:, 0] = -(through @ raw[:half].reshape(-1, 2, 1)).ravel() / self.sizes.projector_px
        columns = [np.arange(carried), poses + 6 * index + np.arange(6), [carried]]
        parts = [
            self._whitened(index, shared, solution.carried),
            self._whitened(index, pose, solution.carried),
            by_carried,
        ]
        if self.model.refined:
            columns.append(effects + EFFECTS * index + np.arange(EFFECTS))
            parts.append(self._whitened(index, by_effects, solution.carried))
        by_point = self._whitened(index, by_point, solution.carried)
        return np.concatenate(columns).astype(np.intp), np.hstack(parts), by_point


def _pose_slopes(
    solution: Solution, index: int, observation: Observation, free: int
) -> tuple[Floats, Floats, Floats]:
    """Differentiate the residuals (4 K,) of one pose in px.

    By the pose (4 K, 6), by `free` intrinsics of both devices and T_projector_camera (4 K, 2 free + 6), and by
    the board's points, each by its own (4 K, 3).
    """
    points, pose = solution.board[observation.ids], solution.poses[index]
    chained, (by_pose, by_pair) = chain(pose, solution.T_projector_camera)
    _, seen = view(points, pose, solution.camera)
    _, projected = view(points, chained, solution.projector)
    rows, n = len(seen), free
    shared = np.zeros((2 * rows, 2 * n + 6))
    shared[:rows, :n] = seen[:, 6 : 6 + n]
    shared[rows:, n : 2 * n] = projected[:, 6 : 6 + n]
    shared[rows:, 2 * n :] = projected[:, :6] @ by_pair
    own = np.concatenate([seen[:, :6], projected[:, :6] @ by_pose])
    # Moving a point by δ moves it by R δ in the device's frame, as a translation would.
    by_point = [part[:, 3:6] @ cv2.Rodrigues(at[:3])[0] for part, at in ((seen, pose), (projected, chained))]
    return own, shared, np.concatenate(by_point)


def huber_weight(residuals: Floats, limit: float) -> Floats:
    """Compute Huber's weights.

    Parameters
    ----------
    residuals : Floats
        (R,) of any unit.
    limit : float
        In the same unit.

    Returns
    -------
    Floats
        (R,) 1 up to `limit`, then falling as 1/r.
    """
    if not np.isfinite(limit):
        return np.ones_like(residuals)
    return np.asarray(limit / np.maximum(np.abs(residuals), limit))


def without_poses(solution: Solution, held: Sequence[int] | int) -> Solution:
    """Leave poses out of a solution.

    Parameters
    ----------
    solution : Solution
        All poses.
    held : Sequence[int] or int
        Their indices.

    Returns
    -------
    Solution
        Of the other poses.
    """
    effects = solution.pose_effects
    return Solution(
        solution.camera,
        solution.projector,
        solution.T_projector_camera,
        np.delete(solution.poses, held, axis=0),
        solution.board,
        solution.carried,
        np.delete(effects, held, axis=0) if len(effects) else effects,
    )
