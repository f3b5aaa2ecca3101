"""What noise makes of a plan's coordinates, orders and depths, before anything is measured."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import AXES, Axis
from fpplab.core.depth import DepthRange
from fpplab.core.errors import ConfigError
from fpplab.patterns.plan import Plan
from fpplab.phase.bounds import widest_interval_share
from fpplab.phase.order_risk import wrong_order_chance
from fpplab.phase.precision import coordinate_spread
from fpplab.reconstruction.depth_range import decoding_bounds


@dataclass(frozen=True)
class PlanPrecision:
    """Standard uncertainties by noise alone."""

    noise: float  # standard deviation of a grey level as a share of the modulation, in every image
    sigma_px: dict[Axis, float]  # of the projector coordinate
    wrong_orders: dict[Axis, float]  # chance that a pixel's fringe order is wrong
    depth_mm: float | None = None  # distance along the camera's axis for which `sigma_um` holds
    sigma_um: float | None = None  # of a depth along the camera's axis


def plan_precision(
    plan: Plan,
    size: tuple[int, int],
    noise: float,
    calibration: Calibration | None = None,
    depth: DepthRange | None = None,
) -> PlanPrecision | None:
    """Compute the uncertainty of a plan on a projector of `size`; None for one with codes beside fringes."""
    if plan.fringe_part is not plan:
        return None
    bounds = decoding_bounds(plan, calibration, depth) if calibration else None
    sigma = {axis: noise * coordinate_spread(plan, axis, size) for axis in plan.axes}
    chances: dict[Axis, float] = {}
    for axis in plan.unwrapped_axes:
        with suppress(ConfigError):  # orders that need a calibration, or another recording
            share = widest_interval_share(bounds, axis, size)
            chances[axis] = float(wrong_order_chance(plan, axis, np.asarray(noise), share))
    if calibration is None:
        return PlanPrecision(noise, sigma, chances)
    z = sum(depth.mm) / 2.0 if depth else _crossing_mm(calibration)
    per_mm = _px_per_mm(calibration, z)
    informed = sum((per_mm[axis] / sigma[axis]) ** 2 for axis in sigma)
    return PlanPrecision(noise, sigma, chances, z, 1e3 / float(np.sqrt(informed)))


def _crossing_mm(calibration: Calibration) -> float:
    """Where the camera's axis passes nearest to that of the projector."""
    pose = calibration.T_projector_camera
    centre, direction = -pose.rotation.T @ pose.translation, pose.rotation[2]
    axis = np.array([0.0, 0.0, 1.0])
    normal = axis - (axis @ direction) * direction
    return float(centre @ normal / (axis @ normal))


def _px_per_mm(calibration: Calibration, z: float) -> dict[Axis, float]:
    """Change of the projector's coordinates by 1 mm of depth."""
    points = np.array([[0.0, 0.0, z - 0.5], [0.0, 0.0, z + 0.5]])
    near, far = calibration.projector.project(points, calibration.T_projector_camera)
    return dict(zip(AXES, np.abs(far - near).tolist(), strict=True))
