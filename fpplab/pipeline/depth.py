"""The range of depths of a measurement, and what a plan can unwrap in it."""

from __future__ import annotations

from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.depth import DepthInterval
from fpplab.devices.rig import DepthSection, Rig
from fpplab.patterns.plan import Plan
from fpplab.phase import check_unwrapping
from fpplab.phase.bounds import widest
from fpplab.reconstruction.depth_range import DepthRange, depth_bounds, first_stated
from fpplab.sessions.session import PLAN, RIG, Session


def plan_with_depth(plan: Plan, depth_mm: tuple[float, float] | None) -> Plan:
    """Give a plan another range of depths.

    Parameters
    ----------
    plan : Plan
        The plan.
    depth_mm : tuple of float, or None
        The range in mm; None leaves the plan as it is.

    Returns
    -------
    Plan
        The plan with the range.

    Raises
    ------
    ConfigError
        The range is not one of two rising positive numbers.
    """
    if depth_mm is None:
        return plan
    return config.validate({**config.plain(plan), "depth_mm": list(depth_mm)}, Plan, "--depth")


def depth_range_of(session: Session, given_mm: DepthInterval | None = None) -> DepthRange | None:
    """Give the range of depths that a session is reconstructed with.

    Parameters
    ----------
    session : Session
        Its plan, and then its rig as recorded, may state one.
    given_mm : tuple of float, optional
        One that has precedence over both, in mm.

    Returns
    -------
    DepthRange or None
        With its source; None where there is none.

    Raises
    ------
    ConfigError
        It is none of two rising positive numbers.
    """
    plan, rig = session.plan, session.path / RIG
    recorded = {key: value for key, value in (session.rig() or {}).items() if key == "depth_mm"}
    return first_stated(
        (plan_with_depth(plan, given_mm).depth_mm if given_mm else None, "--depth"),
        (plan.depth_mm, f"{session.path / PLAN}: 'depth_mm'"),
        (config.validate(recorded, DepthSection, rig).depth_mm, f"{rig}: 'depth_mm'"),
    )


def check_plan(
    plan: Plan,
    source: str,
    calibration: Calibration,
    rig: Rig | None = None,
    given_mm: DepthInterval | None = None,
) -> None:
    """Refuse a plan that cannot be unwrapped with a calibration, before anything is projected.

    Parameters
    ----------
    plan : Plan
        The plan.
    source : str
        What it is called in the message.
    calibration : Calibration
        That it will be reconstructed with.
    rig : Rig, optional
        That it will be measured on; its file may state the range of depths.
    given_mm : tuple of float, optional
        A range of depths in mm that has precedence over the plan's, and that over the rig's.

    Raises
    ------
    ConfigError
        It cannot be unwrapped, needs a range of depths and has none, or part of it lies behind the projector.
    """
    depth = first_stated(
        (given_mm, "--depth"),
        (plan.depth_mm, f"{source}: 'depth_mm'"),
        (rig.file.depth_mm, f"{rig.source}: 'depth_mm'") if rig else (None, ""),
    )
    bounds, size = depth_bounds(plan, calibration, depth), calibration.projector.size
    check_unwrapping(plan, source, {axis: widest(bounds, axis, size) for axis in plan.axes})
