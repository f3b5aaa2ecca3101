"""The range of depths of a measurement, and what a plan can unwrap in it."""

from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.depth import DepthInterval, DepthRange, first_stated
from fpplab.devices.rig import DepthSection, Rig
from fpplab.patterns.plan import Plan
from fpplab.phase import check_codes, check_unwrapping
from fpplab.phase.bounds import widest_interval_share
from fpplab.reconstruction.depth_range import decoding_bounds


def plan_with_depth(plan: Plan, depth_mm: tuple[float, float] | None) -> Plan:
    """Give a plan another range of depths."""
    if depth_mm is None:
        return plan
    return config.validate({**config.plain(plan), "depth_mm": list(depth_mm)}, Plan, "--depth")


def given_depth(depth_mm: DepthInterval | None) -> DepthRange | None:
    """Give the range of depths of the option, which precedes those that plan and rig state."""
    option = {} if depth_mm is None else {"depth_mm": list(depth_mm)}
    return first_stated((config.validate(option, DepthSection, "--depth").depth_mm, "--depth"))


def check_plan(
    plan: Plan,
    source: str,
    calibration: Calibration,
    rig: Rig | None = None,
    given_mm: DepthInterval | None = None,
) -> None:
    """Refuse a plan that cannot be unwrapped with a calibration, before anything is projected."""
    depth = first_stated(
        (given_mm, "--depth"),
        (plan.depth_mm, f"{source}: 'depth_mm'"),
        (rig.file.depth_mm, f"{rig.source}: 'depth_mm'") if rig else (None, ""),
    )
    bounds, size = decoding_bounds(plan, calibration, depth), calibration.projector.size
    check_codes(plan, size, source)
    check_unwrapping(plan, source, {axis: widest_interval_share(bounds, axis, size) for axis in plan.axes})
