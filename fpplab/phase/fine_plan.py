"""A plan of fine fringes alone, for parts whose faces light each other.

Light by way of another face is a mean over many fine fringes and adds to their offset alone; it bends the
phase where faces are less than some periods apart. The error of a groove's walls falls as the period to the
power of 1.5. A set of half as many fringes is bent eight times as much: where it disagrees with the finest,
points are left out, or their uncertainty is widened.
"""

import math

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.conventions import AXES, Floats, axis_length
from fpplab.core.depth import DepthInterval
from fpplab.core.errors import ConfigError
from fpplab.patterns.plan import Plan
from fpplab.phase.limits import FINE_PLAN as LIMITS
from fpplab.phase.order_risk import wrong_order_chance


def fine_plan(
    calibration: Calibration,
    depth_mm: DepthInterval,
    blur_px: float | None = None,
    noise: float | None = None,
) -> Plan:
    """Choose the sets along the axis that shows depth, of which calibration and depth tell the orders.

    With `noise`, of a grey level as a share of the modulation without blur, refuse a plan that it confuses.
    """
    blur_px = LIMITS.blur_px if blur_px is None else blur_px
    spans = _spans_px(calibration, depth_mm)
    axis = AXES[int(np.argmax(spans))]
    length, span_px = calibration.projector.size[AXES.index(axis)], float(spans.max())
    # At 2π blurs the noise of the coordinate, period over contrast, is least.
    finest = length / max(LIMITS.min_period_px, 2.0 * math.pi * blur_px)
    beat = min(LIMITS.beat_share * length / span_px, finest * LIMITS.max_beat_share)
    if finest > LIMITS.max_order_ratio * beat:
        widest_mm = (depth_mm[1] - depth_mm[0]) * LIMITS.max_order_ratio * beat / finest
        raise ConfigError(
            f"depth range: between {depth_mm[0]:g} and {depth_mm[1]:g} mm a pixel may see {span_px:.0f} px "
            f"of the projector, too many to tell {finest:.0f} stripes apart; give a range of about "
            f"{widest_mm:.0f} mm at most"
        )
    sets = zip((0.5 * finest, finest - beat, finest), LIMITS.steps, strict=True)
    fringes = [{"axis": axis, "stripes": round(stripes, 3), "steps": steps} for stripes, steps in sets]
    data = {"fringes": fringes, "unwrapping": "guided", "depth_mm": list(depth_mm), "filter": {}}
    plan = config.validate(data, Plan, "a plan of fine fringes")
    if noise is not None:
        contrast = math.exp(-2.0 * (math.pi * blur_px * finest / length) ** 2)
        chance = float(wrong_order_chance(plan, axis, np.array(noise / contrast), span_px / length))
        if chance > plan.masks.wrong_order_max:
            raise ConfigError(
                f"noise of {100 * noise:.1f} % of the modulation would confuse its fringe orders"
            )
    return plan


def error_ratio(plan: Plan, offered: Plan, projector_size: tuple[int, int]) -> float:
    """How many times less a groove's walls are expected to be bent with the plan that is offered."""
    periods = []
    for each in (plan, offered):
        finest = each.fringes[each.finest_set(each.axes[0])]
        periods.append(axis_length(projector_size, finest.axis) / finest.stripes)
    return float((periods[0] / periods[1]) ** LIMITS.error_power)


def _spans_px(calibration: Calibration, depth_mm: DepthInterval) -> Floats:
    """How many projector px along each axis a camera pixel may see, at most."""
    camera, projector = calibration.camera, calibration.projector
    columns, rows = (np.linspace(0.0, size - 1.0, LIMITS.grid) for size in camera.size)
    slopes = camera.normalise(np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2))
    rays = np.column_stack([slopes, np.ones(len(slopes))])
    ends = [depth * rays for depth in depth_mm]
    pose = calibration.T_projector_camera
    lit = np.logical_or(*(projector.sees(points, pose) for points in ends))
    if not lit.any():
        raise ConfigError(
            f"depth range: the projector lights nothing that the camera sees between {depth_mm[0]:g} and "
            f"{depth_mm[1]:g} mm; give the distances from the camera between which the part lies"
        )
    near, far = (projector.project(points[lit], pose) for points in ends)
    return np.asarray(np.abs(near - far).max(axis=0) + 2.0 * LIMITS.margin_px)
