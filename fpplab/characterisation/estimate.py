"""What the poses so far determine of camera and projector: an estimate that grows by one pose at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.characterisation.bundle import adjust_bundle, estimate_uncertainty, fit_pose
from fpplab.characterisation.fitting import DEFAULT_LEVEL, calibration_of, fit_consistent_poses, model_of
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import DistortionModel, ErrorSizes, ImageSize, Model, Solution
from fpplab.characterisation.problem import without_poses
from fpplab.characterisation.zhang import matrix_of, rms
from fpplab.core.blas import one_blas_thread
from fpplab.core.conventions import Floats, Lattice
from fpplab.core.geometry import RigidTransform
from fpplab.targets import Target


@dataclass(frozen=True, eq=False)
class JointEstimate:
    """Joint fit of the poses so far."""

    target: Target  # the board
    lattice: Lattice  # arrangement of the projector's mirrors
    model: Model  # what is fitted, with the image sizes
    observations: tuple[Observation, ...]  # the poses
    solution: Solution  # all parameters
    sizes: ErrorSizes  # of the errors, as estimated

    @cached_property
    def calibration(self) -> Calibration:
        """Both devices with their covariance, and the board."""
        with one_blas_thread():
            covariance = estimate_uncertainty(self.observations, self.solution, self.model, self.sizes)
        pairs = [self.solution.residuals(k, o) for k, o in enumerate(self.observations)]
        cameras, projectors = zip(*pairs, strict=True)
        figures = {"camera": rms(cameras), "projector": rms(projectors), "joint": rms(cameras + projectors)}
        return calibration_of(
            self.target, self.lattice, self.solution, self.sizes, self.model, figures, covariance
        )

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (n, n) of the devices without the board's scale, which no pose determines."""
        exact = replace(self.model, scale_tolerance=0.0)
        with one_blas_thread():
            return estimate_uncertainty(self.observations, self.solution, exact, self.sizes).covariance

    def with_pose(self, observation: Observation) -> JointEstimate:
        pose = fit_pose(observation, self.solution, self.started_pose(observation))
        start = replace(self.solution, poses=np.vstack([self.solution.poses, pose]))
        return self._fitted((*self.observations, observation), start)

    def without_pose(self, index: int) -> JointEstimate:
        others = tuple(o for k, o in enumerate(self.observations) if k != index)
        return self._fitted(others, without_poses(self.solution, index))

    def started_pose(self, observation: Observation) -> Floats:
        """Compute about where the board stands in a pose, by the camera alone."""
        # returns (6,) rad
        lens, points = self.solution.camera, self.solution.board[observation.ids]
        _, turn, place = cv2.solvePnP(points, observation.camera_px, matrix_of(lens), lens[4:])
        return np.concatenate([turn, place]).ravel()

    @property
    def poses(self) -> list[RigidTransform]:
        """`T_camera_target` of each pose."""
        return [RigidTransform.from_vectors(p[:3], p[3:]) for p in self.solution.poses]

    def _fitted(self, observations: tuple[Observation, ...], start: Solution) -> JointEstimate:
        with one_blas_thread():
            solution, sizes = adjust_bundle(observations, start, self.model, first=self.sizes)
        return replace(self, observations=observations, solution=solution, sizes=sizes)


def first_estimate(
    observations: Sequence[Observation],
    target: Target,
    image_sizes: tuple[ImageSize, ImageSize],
    lattice: Lattice,
    level: DistortionModel = DEFAULT_LEVEL,
    refined: bool = True,
) -> tuple[JointEstimate, dict[str, str]]:
    # image_sizes (width, height) px
    odd: dict[str, str] = {}
    model = model_of(target, image_sizes, level, refined)
    with one_blas_thread():
        kept, (solution, sizes), _ = fit_consistent_poses(observations, target, model, odd)
    return JointEstimate(target, lattice, model, tuple(kept), solution, sizes), odd
