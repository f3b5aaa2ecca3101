"""What a measurement by a plan consists of on a rig, as its devices answer before anything is shown."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fpplab.acquisition.acquire import end_markers
from fpplab.acquisition.timing import planned_timing
from fpplab.calibration.model import Calibration
from fpplab.core.depth import first_stated
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.plan import Plan
from fpplab.setup.plan_precision import PlanPrecision, plan_precision


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
