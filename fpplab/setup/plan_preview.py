"""What a measurement by a plan consists of on a rig, as its devices answer before anything is shown."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fpplab.acquisition.acquire import end_markers
from fpplab.acquisition.timing import planned_timing
from fpplab.calibration.model import Calibration
from fpplab.core.conventions import AXES, Axis
from fpplab.core.depth import DepthRange, first_stated
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.plan import Plan
from fpplab.phase import check_codes
from fpplab.phase.bounds import widest_interval_share
from fpplab.phase.order_risk import axis_precision
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
    for axis in plan.axes:
        share = widest_interval_share(bounds, axis, size)
        sigma[axis], chance = axis_precision(plan, axis, size, noise, share)
        if chance is not None:
            chances[axis] = chance
    if calibration is None:
        return PlanPrecision(noise, sigma, chances)
    geometry = RigGeometry(calibration)
    distance_mm = sum(depth.mm) / 2.0 if depth else geometry.meeting_mm
    per_mm = np.nanmedian(WorkingPoint(geometry, plan, distance_mm).px_per_mm, axis=(0, 1))
    informed = sum((per_mm[AXES.index(axis)] / sigma[axis]) ** 2 for axis in sigma)
    return PlanPrecision(noise, sigma, chances, distance_mm, 1e3 / float(np.sqrt(informed)))


@dataclass(frozen=True)
class PlanPreview:
    """A plan on a rig."""

    trigger: str  # "stepped" or "triggered"
    images: int  # number of images that are taken
    end_markers: int  # number of further patterns, black and white, that prove the synchronisation
    bit_planes: int  # sum of the bit depths of all patterns
    loads: int  # how often the projector changes to another image of its flash, or to another video frame
    exposure_s: float  # the camera's exposure in s, as read back; the longest of several, as the times are
    light_s: float  # s for which each pattern is shown; in a stepped plan at least
    dark_s: float  # least s from the end of one pattern to the beginning of the next; 0 in a stepped plan
    period_s: float  # least s from one pattern to the next
    period_set_by: str  # what keeps it from being shorter
    least_s: float  # least s for all patterns, without loading them and preparing the devices
    precision: PlanPrecision  # what noise makes of it


def preview_plan(
    rig: Rig, plan: Plan, source: Path | str, noise: float = 0.02, calibration: Calibration | None = None
) -> tuple[PlanPreview, Sequence[Pattern]]:
    # The camera is configured and the patterns are loaded, as for a measurement; nothing is projected. What
    # shows only while patterns are shown is not found, such as a trigger cable that is not connected.
    camera, caps = rig.camera, rig.projector.caps
    plan.check_projector(caps.size, source)
    check_codes(plan, caps.size, str(source))
    ends = end_markers(plan, caps.size)
    patterns = [*make_patterns(plan, caps.size, caps.lattice), *ends]
    rig.projector.load(patterns)
    timings = []
    for each in plan.exposures:
        exposure_s = camera.configure(rig.camera_settings(each, plan.bits)).exposure_s
        timings.append((exposure_s, planned_timing(rig, plan, patterns, exposure_s)))
    exposure_s, timing = max(timings, key=lambda each: each[0])
    preview = PlanPreview(
        trigger=plan.trigger,
        images=plan.frames,
        end_markers=len(ends),
        bit_planes=sum(p.bit_depth for p in patterns),
        loads=rig.projector.loads.images,
        exposure_s=exposure_s,
        light_s=timing.light_s,
        dark_s=timing.period_s - timing.light_s,
        period_s=timing.period_s,
        period_set_by=timing.limit,
        least_s=sum(
            (len(images) + len(ends)) * each.period_s
            for images, (_, each) in zip(plan.passes, timings, strict=True)
        ),
        precision=plan_precision(
            plan, caps.size, noise, calibration, first_stated((plan.depth_mm, ""), (rig.file.depth_mm, ""))
        ),
    )
    return preview, patterns
