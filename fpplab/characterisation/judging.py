"""Judge a calibration by poses that it was not fitted to: their errors, compared with those that it predicts.

Only the pose of the board is fitted to each capture. What is left should be no more than noise, what the
errors of one pose share, and the uncertainty of the devices, less what the pose takes up. The square sum of a
device's residuals then follows a sum of weighted χ², here approximated by one χ² of the same mean and
variance (F. E. Satterthwaite, "An approximate distribution of estimates of variance components", 1946). The
size of what the errors of one pose share is itself known from few poses, as the variance of as many normal
values, less one: the probability is averaged over it, as Student's t does for a single value.

The uncertainty of the devices that `fpplab.characterisation.bundle.uncertainty` gives holds with the board as
it was found, so that the board's own does not count again; with four poses the prediction is 4 % too small
for that, with more less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from fpplab.calibration.board import FittedBoard, FittedErrors
from fpplab.calibration.displacements import covariance_root
from fpplab.calibration.model import INTRINSICS, Calibration
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.outliers import reject_points, rejectable_points
from fpplab.characterisation.parameters import (
    DistortionModel,
    ErrorSizes,
    Model,
    Solution,
    parameter_names,
    vectors_of,
)
from fpplab.characterisation.pose_effects import FUNCTIONS, effects_of_pose
from fpplab.characterisation.problem import Problem
from fpplab.characterisation.result import Rejected
from fpplab.characterisation.zhang import matrix_of, rms
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError

DEVICES = ("camera", "projector")


@dataclass(frozen=True)
class Errors:
    """Errors of one device, seen and predicted."""

    rms_px: float  # root mean square length of the residuals in px
    predicted_px: float  # that which the calibration predicts
    chance: float  # probability of errors as great as these, if the calibration holds

    @property
    def contradicts(self) -> bool:
        """Whether the errors are greater than chance makes them once in a thousand times."""
        return self.chance < 1e-3


@dataclass(frozen=True, eq=False)
class JudgedPose:
    """A pose that was not fitted."""

    name: str  # of the pose
    points: int  # how many points of the board were used
    camera: Errors  # of the two devices
    projector: Errors  # of the two devices

    @property
    def contradicts(self) -> bool:
        """Whether the errors in one of the devices are greater than chance makes them."""
        return self.camera.contradicts or self.projector.contradicts


@dataclass(frozen=True, eq=False)
class Judgement:
    """What poses that were not fitted say about a calibration."""

    poses: tuple[JudgedPose, ...]  # the poses
    camera: Errors  # of all poses together
    projector: Errors  # of all poses together
    rejected: tuple[Rejected, ...]  # points that were not used
    left_out: dict[str, str]  # why a pose was not used, by its name

    @property
    def contradicted(self) -> bool:
        """Whether all poses together contradict the calibration."""
        return self.camera.contradicts or self.projector.contradicts

    @property
    def verdict(self) -> str:
        """The verdict in one sentence, with what to do."""
        figures = "; ".join(
            f"{name} {errors.rms_px:.3f} px where {errors.predicted_px:.3f} px were predicted"
            for name, errors in ((d, getattr(self, d)) for d in DEVICES)
        )
        if self.contradicted:
            return (
                f"these poses contradict the calibration: {figures}; camera, projector or a lens have moved "
                "since, or its stated uncertainty is too small: characterise again, with more poses"
            )
        if odd := [pose.name for pose in self.poses if pose.contradicts]:
            return (
                f"the calibration holds: {figures}; but not in {', '.join(odd)}: check these poses for motion"
            )
        return f"the calibration holds: {figures}"

    def summary(self) -> dict[str, Any]:
        return {
            "contradicted": self.contradicted,
            "verdict": self.verdict,
            **{device: vars(getattr(self, device)) for device in DEVICES},
            "poses": [
                {"pose": p.name, "points": p.points, **{d: vars(getattr(p, d)) for d in DEVICES}}
                for p in self.poses
            ],
            "rejected": len(self.rejected),
        }


def judge(
    calibration: Calibration,
    observations: Sequence[Observation],
    left_out: dict[str, str] | None = None,
    source: str = "the calibration",
) -> Judgement:
    """Judge a calibration by poses that it was not fitted to."""
    if not observations:
        raise CalibrationError(
            f"{source}: there is no pose to judge by ({'; '.join((left_out or {}).values())})"
        )
    return judge_as_fitted(CalibrationAsFitted.of(calibration, source), observations, left_out)


def judge_as_fitted(
    judged: CalibrationAsFitted, observations: Sequence[Observation], left_out: dict[str, str] | None = None
) -> Judgement:
    """Judge a calibration by poses of what its `board` is."""
    poses = np.array([judged.pose(o) for o in observations])
    rejectable = rejectable_points(observations)
    kept, rejected = reject_points(observations, replace(judged.devices, poses=poses), rejectable)
    predictions = [_prediction(judged, o) for o in kept]
    scales = _scales_of_effects(judged.errors.poses)
    camera, projector = (_errors_of_device(predictions, d, scales) for d in (0, 1))
    return Judgement(
        tuple(_judged_pose(prediction, scales) for prediction in predictions),
        camera,
        projector,
        tuple(rejected),
        left_out or {},
    )


def judged_board(calibration: Calibration, source: str) -> FittedBoard:
    """Give the board by whose poses a calibration can be judged."""
    if calibration.board is None or calibration.uncertainty is None:
        missing = "board" if calibration.board is None else "uncertainty"
        raise CalibrationError(
            f"{source}: '{missing}' is missing, as in files of other programs and of earlier versions, so "
            "the errors to be expected are unknown; characterise again"
        )
    return calibration.board


@dataclass(frozen=True, eq=False)
class CalibrationAsFitted:
    """A calibration as the joint adjustment has it, and a factor (n, n) of its covariance."""

    devices: Solution
    errors: FittedErrors
    level: DistortionModel
    factor: Floats

    @classmethod
    def of(cls, calibration: Calibration, source: str) -> CalibrationAsFitted:
        """Take a calibration that a characterisation made."""
        fitted, uncertainty = judged_board(calibration, source), calibration.uncertainty
        assert uncertainty is not None
        free = sum(name.startswith("camera.") for name in uncertainty.names)
        levels = [level for level in DistortionModel if len(level.terms) == free]
        names = parameter_names(levels[0]) if levels else ()
        if set(names) != set(uncertainty.names):
            raise CalibrationError(
                f"{source}: 'uncertainty.names' are not those of a characterisation; characterise again"
            )
        camera, projector = calibration.camera.intrinsics, calibration.projector.intrinsics
        pair = vectors_of(calibration.T_projector_camera)
        devices = Solution(camera, projector, pair, np.zeros((1, 6)), fitted.points, fitted.errors.carried)
        order = [uncertainty.names.index(name) for name in names]
        exact = cls(devices, fitted.errors, levels[0], np.zeros((len(names), 0)))
        covariance = uncertainty.covariance[np.ix_(order, order)] - np.outer(exact.longer, exact.longer)
        return replace(exact, factor=covariance_root(covariance))

    @property
    def longer(self) -> Floats:
        """By how much the board's scale may change the parameters, (n,): no image shows it."""
        pair = self.devices.T_projector_camera
        others = np.zeros(2 * len(self.level.terms) + 3)
        return np.append(others, self.errors.scale * pair[3:])

    @property
    def shared(self) -> Floats:
        """Standard deviations of the errors that the points of one pose share."""
        return np.repeat([self.errors.camera_shared_px, self.errors.projector_shared_px], 2 * FUNCTIONS)

    def parameters(self) -> Floats:
        free, devices = len(self.level.terms), self.devices
        return np.concatenate([devices.camera[:free], devices.projector[:free], devices.T_projector_camera])

    def with_parameters(self, parameters: Floats) -> CalibrationAsFitted:
        free = len(self.level.terms)
        camera, projector, pair = np.split(parameters, [free, 2 * free])
        lenses = [np.append(lens, np.zeros(len(INTRINSICS) - free)) for lens in (camera, projector)]
        devices = replace(self.devices, camera=lenses[0], projector=lenses[1], T_projector_camera=pair)
        return replace(self, devices=devices)

    def problem(self, observation: Observation, pose: Floats) -> tuple[Problem, Solution]:
        at = replace(self.devices, poses=pose[None])
        sizes = ErrorSizes(self.errors.camera_px, self.errors.projector_px, 0.0, 0.0)
        return Problem((observation,), Model(self.level, at.board), sizes, at), at

    def pose(self, observation: Observation) -> Floats:
        """Fit the pose (6,) of the board, by residuals in standard deviations."""
        points, lens = self.devices.board[observation.ids], self.devices.camera
        _, turn, place = cv2.solvePnP(
            points, observation.camera_px, matrix_of(lens), lens[4:], flags=cv2.SOLVEPNP_SQPNP
        )  # which points that nearly lie in a plane do not mislead
        start = np.concatenate([turn, place]).ravel()
        problem, near = self.problem(observation, start)

        def misfit(pose: Floats) -> Floats:
            return problem.weighted_residuals(0, replace(near, poses=pose[None]), np.inf)[0]

        return np.asarray(least_squares(misfit, start, x_scale="jac", method="lm").x)


@dataclass(frozen=True, eq=False)
class _Prediction:
    """Residuals of one pose by device, and factors of their covariance."""

    name: str
    residuals: Floats  # (2, 2 K) px
    noise: Floats  # (2, 2 K, 4 K), of errors of single points
    effects: Floats  # (2, 2 K, E), of errors that the points of this pose share
    common: Floats  # (2, 2 K, n), of errors of the devices


def _prediction(judged: CalibrationAsFitted, observation: Observation) -> _Prediction:
    """Fit the pose and predict its residuals: what the pose takes up of all errors is gone from them."""
    problem, at = judged.problem(observation, judged.pose(observation))
    _, slopes, _ = problem.slopes(0, at)
    n, rows = len(judged.factor), len(slopes)
    fitted, _ = np.linalg.qr(slopes[:, n : n + 6])
    every = np.hstack(
        [np.eye(rows), effects_of_pose(problem, 0, at) * judged.shared, slopes[:, :n] @ judged.factor]
    )
    residuals = np.stack([part.ravel() for part in at.residuals(0, observation)])
    remaining = problem.unwhitened(0, every - fitted @ (fitted.T @ every), at.carried)
    remaining[uncoded := np.isnan(residuals.ravel())] = 0.0
    residuals.ravel()[uncoded] = 0.0
    of_device = remaining.reshape(2, rows // 2, -1)
    parts = np.split(of_device, [rows, of_device.shape[-1] - n], axis=-1)
    return _Prediction(observation.name, residuals, *parts)


def _scales_of_effects(poses: int | None) -> tuple[Floats, Floats]:
    """Ratios (S,) of true to estimated variance of effects of poses, and their probabilities."""
    if poses is None:
        return np.ones(1), np.ones(1)
    freedom = poses - 1
    lowest, highest = chi2.ppf([1e-9, 1.0 - 1e-9], freedom)  # chances far below any limit
    values = np.geomspace(lowest, highest, 200)
    chances = chi2.pdf(values, freedom) * values
    return freedom / values, chances / chances.sum()


def _judged_pose(prediction: _Prediction, scales: tuple[Floats, Floats]) -> JudgedPose:
    camera, projector = (_errors_of_device([prediction], d, scales) for d in (0, 1))
    return JudgedPose(prediction.name, prediction.residuals.shape[1] // 2, camera, projector)


def _errors_of_device(
    predictions: Sequence[_Prediction], device: int, scales: tuple[Floats, Floats]
) -> Errors:
    """Errors of one device in some poses, which share those of the devices."""
    residuals = [prediction.residuals[device].reshape(-1, 2) for prediction in predictions]
    parts = [(p.noise[device], p.effects[device], p.common[device]) for p in predictions]
    # Coefficients by powers of the scale s of the trace of C, and of tr C², for the covariance
    # C = diag(noise noiseᵀ + s effects effectsᵀ) + common commonᵀ.
    mean = np.sum([[np.sum(n**2) + np.sum(c**2), np.sum(e**2)] for n, e, c in parts], axis=0)
    square = np.sum(
        [
            [
                np.sum((n.T @ n) ** 2) + 2.0 * np.sum((n.T @ c) ** 2),
                2.0 * np.sum((n.T @ e) ** 2) + 2.0 * np.sum((e.T @ c) ** 2),
                np.sum((e.T @ e) ** 2),
            ]
            for n, e, c in parts
        ],
        axis=0,
    )
    square[0] += np.sum(sum(c.T @ c for *_, c in parts) ** 2)
    scale, chances = scales
    expected = mean[0] + mean[1] * scale
    freedom = expected**2 / (square[0] + square[1] * scale + square[2] * scale**2)
    total, points = float(sum(np.sum(r**2) for r in residuals)), sum(len(r) for r in residuals)
    chance = float(chances @ chi2.sf(freedom * total / expected, freedom))
    return Errors(rms(residuals), float(np.sqrt(mean.sum() / points)), chance)
