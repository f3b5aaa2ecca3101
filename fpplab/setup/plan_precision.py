"""What noise makes of a plan's coordinates, orders and depths, before anything is measured."""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import AXES, Axis
from fpplab.core.depth import DepthRange
from fpplab.core.errors import ConfigError
from fpplab.patterns.plan import Plan
from fpplab.phase.bounds import widest_interval_share
from fpplab.phase.coded_axes import axes_by_codes, axes_with_orders, coded_coordinate
from fpplab.phase.order_risk import wrong_order_chance
from fpplab.phase.precision import coordinate_spread
from fpplab.reconstruction.depth_range import decoding_bounds
from fpplab.setup.live.expectation import RigGeometry, WorkingPoint


@dataclass(frozen=True)
class PlanPrecision:
    """Standard uncertainties by noise alone."""

    noise: float  # standard deviation of a grey level as a share of the modulation, in every image
    sigma_px: dict[Axis, float]  # of the projector coordinate
    wrong_orders: dict[Axis, float]  # chance that a pixel's fringe order, or its code, is taken for another
    depth_mm: float | None = None  # distance along the camera's axis for which `sigma_um` holds
    sigma_um: float | None = None  # along the camera's rays


def plan_precision(
    plan: Plan,
    size: tuple[int, int],
    noise: float,
    calibration: Calibration | None = None,
    depth: DepthRange | None = None,
) -> PlanPrecision:
    """Compute the uncertainty of a plan on a projector of `size`."""
    bounds = decoding_bounds(plan, calibration, depth) if calibration else None
    sigma: dict[Axis, float] = {}
    chances: dict[Axis, float] = {}
    by_codes, with_orders = axes_by_codes(plan, size), axes_with_orders(plan, size)
    for axis in plan.axes:
        if axis in by_codes:
            sigma[axis], chances[axis] = coded_coordinate(plan, axis, size, noise)
            continue
        fringes = plan.fringe_part
        assert fringes is not None  # without codes
        sigma[axis] = noise * coordinate_spread(fringes, axis, size)
        if axis in plan.unwrapped_axes and axis not in with_orders:
            with suppress(ConfigError):  # orders that need a calibration, or another recording
                share = widest_interval_share(bounds, axis, size)
                chances[axis] = float(wrong_order_chance(fringes, axis, np.asarray(noise), share))
    if calibration is None:
        return PlanPrecision(noise, sigma, chances)
    geometry = RigGeometry(calibration)
    distance_mm = sum(depth.mm) / 2.0 if depth else geometry.meeting_mm
    per_mm = np.nanmedian(WorkingPoint(geometry, plan, distance_mm).px_per_mm, axis=(0, 1))
    informed = sum((per_mm[AXES.index(axis)] / sigma[axis]) ** 2 for axis in sigma)
    return PlanPrecision(noise, sigma, chances, distance_mm, 1e3 / float(np.sqrt(informed)))
