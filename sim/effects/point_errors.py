"""Errors that the points of a board have in each pose, of causes that the twin does not know.

Grain of the print, air that is warm, a mount that yields: a characterisation finds how large these are. Each
pose has draws of its own, which stay the same when it is recorded again.
"""

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from scipy.optimize import nnls
from typing_extensions import override

from fpplab.characterisation.pose_effects import FUNCTIONS
from fpplab.core.config import Document
from fpplab.core.conventions import Floats
from sim.effects.base import Effect, EffectWorld
from sim.effects.step import ParametersT, StepContext
from sim.parameter_entry import table_entry

ErrorSizePx = Annotated[float, Field(ge=0, le=10)]
MIN_SIGNIFICANCE = 3.0
"""Standard uncertainties by which the bench's errors must exceed the twin's (chosen: 1 in 700 by chance)."""


class PointErrors(Document):
    """Standard deviations in the camera, in its px, and in the projector, in px of the projector."""

    points_px: tuple[ErrorSizePx, ErrorSizePx] = (0.0, 0.0)
    """Of each coordinate of each point."""
    poses_px: tuple[ErrorSizePx, ErrorSizePx] = (0.0, 0.0)
    """Of each of six smooth functions over the board, by which all points of a pose are displaced."""


class PointErrorsField(Document):
    """Of a world file."""

    point_errors: PointErrors | None = None
    """Errors of the points of boards; None where there are none."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PointErrorsParameters:
    """What a matching may change."""

    point_errors_px: tuple[float, float] = field(
        default=(0.0, 0.0),
        metadata=table_entry(
            "Standard deviation of a board's points in camera and projector, other in each pose, in px.",
            "point_errors.points_px",
            parts=("point_errors_camera_px", "point_errors_projector_px"),
            effect="point_errors_px",
        ),
    )
    pose_errors_px: tuple[float, float] = field(
        default=(0.0, 0.0),
        metadata=table_entry(
            "That of the smooth functions over the board which the points of a pose share, in px.",
            "point_errors.poses_px",
            parts=("pose_errors_camera_px", "pose_errors_projector_px"),
            effect="pose_errors_px",
        ),
    )


class BoardPointErrors(Effect[PointErrorsField]):
    """Errors of a board's points in each pose."""

    name = "point errors"
    explains = "errors of the board's points in each pose beyond those of noise and print"
    order = 60
    parameters = PointErrorsParameters
    strength = ("point_errors_px", "pose_errors_px")
    world_fields = PointErrorsField
    varies = True
    characterises = True

    @override
    def clear(self, data: dict[str, Any]) -> None:
        data["point_errors"] = None

    @override
    def point_errors_px(self, world: EffectWorld) -> Floats | None:
        sizes = self.own(world).point_errors
        return None if sizes is None else np.array([sizes.points_px, sizes.poses_px])

    @override
    def propose(self, at: StepContext[ParametersT]) -> ParametersT:
        now = self.without(at.parameters)
        bench, own = at.with_parameters(now).reprojection_errors()
        wanted = bench.px2 - own.px2
        sigma = np.hypot(bench.sigma_px2, own.sigma_px2)
        significant = wanted > MIN_SIGNIFICANCE * sigma
        if not significant[0].any():
            return now
        # How much a characterisation sees depends on how it averages: errors of points are tried, then both.
        tried, effect, before = np.zeros((2, 2)), [], own.px2
        for kind, size in enumerate(_first_sizes(np.where(significant, wanted, 0.0))):
            tried[kind] = size
            _, trial = at.with_parameters(_with_sizes(now, tried)).reprojection_errors()
            effect.append(trial.px2 - before)
            before = trial.px2
        slopes, aims = np.array(effect) / sigma, wanted / sigma
        factors = [nnls(slopes[..., device].T, aims[:, device])[0] for device in (0, 1)]
        return _with_sizes(now, tried * np.sqrt(np.transpose(factors)))


def _first_sizes(wanted: Floats) -> Floats:
    """Guess sizes (2, 2) of points and poses by what own poses and poses left out have too little, in px²."""
    fitted, left_out = wanted
    # A left-out pose shows all six functions, of which those that move the board as a whole are fitted.
    return np.asarray(np.sqrt(np.stack([fitted, np.maximum(left_out - fitted, 0.0) / FUNCTIONS])))


def _with_sizes(now: ParametersT, sizes: Floats) -> ParametersT:
    # sizes (2, 2) of points and poses in camera and projector
    (camera, projector), (shared_camera, shared_projector) = sizes.tolist()
    return now.with_effect(
        PointErrorsParameters(
            point_errors_px=(camera, projector), pose_errors_px=(shared_camera, shared_projector)
        )
    )
