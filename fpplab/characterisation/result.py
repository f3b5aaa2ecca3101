"""What a characterisation found, and how good it is."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

from fpplab.calibration.model import Calibration
from fpplab.characterisation.bundle import DistortionModel
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.zhang import rms
from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform


@dataclass(frozen=True)
class Rejected:
    """A point of a pose that was not used. residual_px: how far it lies from where `device` should see it."""

    pose: str
    point: int
    device: str
    residual_px: float
    why: str


@dataclass(frozen=True)
class ModelTrial:
    """What one level of the model reaches: RMS in px by device.

    fitted_px: of `camera`, `projector` and `joint`. held_out_px: the same, in poses that the devices were
    not fitted to; None with too few poses.
    """

    level: DistortionModel
    fitted_px: dict[str, float]
    held_out_px: dict[str, float] | None


@dataclass(frozen=True, eq=False)
class Characterisation:
    """A calibration with all that is known about how good it is.

    observations: the poses used; residuals are in their order, model minus observation, (K, 2) px.
    poses: `T_camera_target` of each. apart_px: RMS of `camera` and `projector` fitted apart, and
    of the `stereo` step on top, with k1 k2 p1 p2. leave_one_out_px: RMS of `camera` and `projector` in
    poses that the devices were not fitted to; None with too few poses. board: points (P, 3) in mm as used.
    left_out: why, by name of pose. sigma: standard uncertainty, as `camera.fx` or
    `T_projector_camera.x`, in px, rad or mm; the covariance is the calibration's. level: of the model
    used. trials: of every level tried. rejected: points not used. warnings: what the poses leave open.
    drawn: where the board's points were drawn, (P, 3) in mm, if its shape was refined.
    """

    calibration: Calibration
    observations: tuple[Observation, ...]
    poses: tuple[RigidTransform, ...]
    camera_residuals: tuple[Floats, ...]
    projector_residuals: tuple[Floats, ...]
    apart_px: dict[str, float]
    leave_one_out_px: dict[str, float] | None
    board: Floats
    left_out: dict[str, str]
    sigma: dict[str, float]
    level: DistortionModel = DistortionModel.TANGENTIAL
    trials: tuple[ModelTrial, ...] = ()
    rejected: tuple[Rejected, ...] = ()
    warnings: tuple[str, ...] = ()
    drawn: Floats | None = None

    @property
    def points(self) -> int:
        """How many points were used, all poses together."""
        return sum(len(o.ids) for o in self.observations)

    def summary(self) -> dict[str, Any]:
        """The figures for a machine to read, as the command line prints them."""
        figures = self.calibration.rms_px
        return {
            "camera": {"rms_px": figures["camera"]},
            "projector": {"rms_px": figures["projector"]},
            "joint_rms_px": figures["joint"],
            "stereo_rms_px": self.apart_px["stereo"],
            "leave_one_out": _both(self.leave_one_out_px),
            "poses": len(self.observations),
            "points": self.points,
            "rejected": len(self.rejected),
            "model": str(self.level),
            "models": [
                {"model": str(t.level), "fitted": _both(t.fitted_px), "held_out": _both(t.held_out_px)}
                for t in self.trials
            ],
            "warnings": list(self.warnings),
        }

    def facts(self) -> dict[str, str]:
        """What the head of a report says: the model, what else was tried, warnings, and points rejected."""
        facts = {"Model": _terms(self.level)}
        for trial in self.trials:
            facts[f"Error with {trial.level}"] = _errors(trial)
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


def _both(figures: dict[str, float] | None) -> dict[str, float | None]:
    return {f"{device}_px": (figures or {}).get(device) for device in ("camera", "projector")}


def _terms(level: DistortionModel) -> str:
    return f"{level}: distortion {' '.join(level.terms[4:])}"


def _errors(trial: ModelTrial) -> str:
    fitted = " / ".join(f"{trial.fitted_px[d]:.3f}" for d in ("camera", "projector"))
    if trial.held_out_px is None:
        return f"camera / projector {fitted} px fitted"
    held = " / ".join(f"{trial.held_out_px[d]:.3f}" for d in ("camera", "projector"))
    return f"camera / projector {fitted} px fitted, {held} px in poses left out"
