"""Result of a characterisation, and its quality."""

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.characterisation.limits import USUAL_LIMITS
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.parameters import DistortionModel, ErrorSizes, Model, Solution
from fpplab.characterisation.validation import Repeat, Validation
from fpplab.characterisation.zhang import rms
from fpplab.core.conventions import Floats
from fpplab.core.errors import DataError
from fpplab.core.geometry import RigidTransform


@dataclass(frozen=True)
class Rejected:
    """A point of a pose that was not used."""

    pose: str  # name of the pose
    point: int  # id of the point
    device: str  # `camera` or `projector`, in which it lies wrong
    residual_px: float  # distance in px from where `device` should see it
    why: str  # the reason in words


@dataclass(frozen=True)
class ModelTrial:
    """Errors of one level of the distortion model."""

    level: DistortionModel  # the level
    fitted_px: dict[str, float]  # RMS in px of `camera`, `projector` and `joint`
    held_out_px: dict[str, float] | None  # the same in poses that the devices were not fitted to


@dataclass(frozen=True, eq=False)
class DeviceResiduals:
    """What one device saw of the board, by pose."""

    size: tuple[int, int]  # width and height in px
    pixels: tuple[Floats, ...]  # (K, 2) px
    residuals: tuple[Floats, ...]  # model minus observation, (K, 2) px


@dataclass(frozen=True, eq=False)
class Characterisation:
    """A calibration with all that is known about its quality."""

    calibration: Calibration  # both devices and the pose between them, with the covariance
    observations: tuple[Observation, ...]  # the poses used; residuals are in their order
    poses: tuple[RigidTransform, ...]  # `T_camera_target` of each
    camera_residuals: tuple[Floats, ...]  # model minus observation of each pose, (K, 2) in px
    projector_residuals: tuple[Floats, ...]  # model minus observation of each pose, (K, 2) in px
    separate_px: dict[str, float]  # RMS in px of `camera` and `projector` fitted separately
    leave_one_out_px: dict[str, float] | None
    board: Floats  # (P, 3) points of the board in mm as used
    left_out: dict[str, str]  # why a pose was not used, by its name
    sigma: dict[str, float]  # standard uncertainty by parameter
    level: DistortionModel = DistortionModel.TANGENTIAL  # of the model used
    trials: tuple[ModelTrial, ...] = ()  # of every level tried
    rejected: tuple[Rejected, ...] = ()  # points that were not used
    warnings: tuple[str, ...] = ()  # what the poses leave undetermined
    drawn: Floats | None = None  # (P, 3) mm
    solution: Solution | None = None  # all parameters as adjusted
    sizes: ErrorSizes | None = None  # standard deviations of the errors of each kind, as estimated
    model: Model | None = None  # what was fitted
    validation: Validation | None = None  # calibrations from fewer poses, against the covariance's prediction

    @property
    def by_device(self) -> dict[str, DeviceResiduals]:
        """Where `camera` and `projector` saw the board's points, and their residuals."""
        calibration, seen = self.calibration, self.observations
        cameras, projectors = tuple(o.camera_px for o in seen), tuple(o.projector_px for o in seen)
        return {
            "camera": DeviceResiduals(calibration.camera.size, cameras, self.camera_residuals),
            "projector": DeviceResiduals(calibration.projector.size, projectors, self.projector_residuals),
        }

    @property
    def points(self) -> int:
        return sum(len(o.ids) for o in self.observations)

    def summary(self) -> dict[str, Any]:
        figures = self.calibration.rms_px
        return {
            "camera": {"rms_px": figures["camera"]},
            "projector": {"rms_px": figures["projector"]},
            "joint_rms_px": figures["joint"],
            "stereo_rms_px": self.separate_px["stereo"],
            "leave_one_out": _both(self.leave_one_out_px),
            "poses": len(self.observations),
            "points": self.points,
            "rejected": len(self.rejected),
            "model": str(self.level),
            "models": [
                {"model": str(t.level), "fitted": _both(t.fitted_px), "held_out": _both(t.held_out_px)}
                for t in self.trials
            ],
            "jackknife": _repeats(self.validation.jackknife if self.validation else ()),
            "halves": _repeats(self.validation.halves if self.validation else ()),
            "warnings": list(self.warnings),
            **self._changed_limits(),
        }

    def _changed_limits(self) -> dict[str, Any]:
        """What is printed of limits that are not the usual ones."""
        stated = self.model.limits.model_dump() if self.model else {}
        changed = {name: value for name, value in stated.items() if value != getattr(USUAL_LIMITS, name)}
        return {"limits": changed} if changed else {}

    def facts(self) -> dict[str, str]:
        facts = {"Model": _terms(self.level)}
        for trial in self.trials:
            facts[f"Error with {trial.level}"] = _errors_text(trial)
        for number, warning in enumerate(self.warnings, 1):
            facts[f"Warning {number}"] = warning
        reasons: dict[str, list[str]] = defaultdict(list)
        for point in self.rejected:
            reasons[point.pose].append(point.why)
        return facts | {f"Points rejected in {pose}": "; ".join(why) for pose, why in reasons.items()}

    @property
    def pose_rms_px(self) -> dict[str, dict[str, float]]:
        """RMS of `camera` and `projector` by name of pose."""
        pairs = zip(self.observations, self.camera_residuals, self.projector_residuals, strict=True)
        return {o.name: {"camera": rms([c]), "projector": rms([p])} for o, c, p in pairs}


def _repeats(repeats: tuple[Repeat, ...]) -> dict[str, dict[str, float | str]]:
    return {
        repeat.quantity: {
            "unit": repeat.unit,
            "modelled": repeat.modelled,
            "stated": repeat.stated,
            "changed": repeat.changed,
            "predicted": repeat.predicted,
            "chance": repeat.chance,
        }
        for repeat in repeats
    }


def _both(figures: dict[str, float] | None) -> dict[str, float | None]:
    return {f"{device}_px": (figures or {}).get(device) for device in ("camera", "projector")}


def _terms(level: DistortionModel) -> str:
    return f"{level}: distortion {' '.join(level.terms[4:])}"


def _errors_text(trial: ModelTrial) -> str:
    fitted = " / ".join(f"{trial.fitted_px[d]:.3f}" for d in ("camera", "projector"))
    if trial.held_out_px is None:
        return f"camera / projector {fitted} px fitted"
    held = " / ".join(f"{trial.held_out_px[d]:.3f}" for d in ("camera", "projector"))
    return f"camera / projector {fitted} px fitted, {held} px in poses left out"


def epipolar_distances(observation: Observation, calibration: Calibration) -> Floats:
    """Compute the signed distance of each point from its epipolar curve on the projector."""
    # A camera pixel is a ray, whose image on the projector is a curve (a line without distortion); the
    # distance is that of the projector's point from it, at the depth at which both rays pass nearest,
    # positive to the right of the direction in which depth moves it. Unlike the reprojection errors it does
    # not depend on the board.
    # returns (K,) px
    pair_of, projector = calibration.T_projector_camera, calibration.projector
    slopes = calibration.camera.normalise(observation.camera_px)
    rays = np.column_stack([slopes, np.ones(len(slopes))])
    depth = _depths(rays, observation.projector_px, calibration)
    at, beyond = (projector.project(rays * z[:, None], pair_of) for z in (depth, depth * (1.0 + 1e-4)))
    along = (beyond - at) / np.linalg.norm(beyond - at, axis=1)[:, None]
    differences = observation.projector_px - at
    return np.asarray(along[:, 0] * differences[:, 1] - along[:, 1] * differences[:, 0])


def _depths(rays: Floats, projector_px: Floats, calibration: Calibration) -> Floats:
    """Depths (K,) in mm at which the camera's rays (K, 3) pass nearest to the projector's rays."""
    slopes = calibration.projector.normalise(projector_px)
    turned = np.column_stack([slopes, np.ones(len(slopes))]) @ calibration.T_projector_camera.rotation
    across = np.cross(rays, turned)
    away = np.cross(np.broadcast_to(calibration.projector_centre, rays.shape), turned)
    return np.asarray((away * across).sum(axis=1) / (across**2).sum(axis=1))


def board_deviation(characterisation: Characterisation) -> tuple[Floats, Floats]:
    """Compute how far the refined board differs from the board as drawn."""
    # Position, rotation and scale of the board do not count; no image can separate the scale from the
    # distance.
    # returns (K, 3) mm
    if characterisation.drawn is None:
        raise DataError("the board was taken as it is drawn; there is no shape to show")
    detected = np.unique(np.concatenate([o.ids for o in characterisation.observations]))
    drawn = characterisation.drawn[detected]
    return drawn, 1e3 * (align_similarity(characterisation.board[detected], drawn) - drawn)


def align_similarity(points: Floats, onto: Floats) -> Floats:
    """Align points with others by the least-squares rotation, translation and scale."""
    # points (K, 3); onto (K, 3); returns (K, 3)
    centre, target_centre = points.mean(axis=0), onto.mean(axis=0)
    u, sizes, vt = np.linalg.svd((onto - target_centre).T @ (points - centre))
    handed = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    scale = (sizes * handed).sum() / ((points - centre) ** 2).sum()
    return np.asarray(scale * (points - centre) @ ((u * handed) @ vt).T + target_centre)
