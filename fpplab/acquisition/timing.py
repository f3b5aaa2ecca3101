"""Times of a run: how long each pattern is shown, and how far its trigger pulses are apart.

The projector is the clock, and a camera ignores a pulse that comes before it is ready. So what the devices
say of themselves decides: the camera's exposure, readout and the period at which it takes pulses, and the
projector's least exposures, least gap and load times. What a camera does not say is allowed for, or stated in
the rig file. No other module decides times.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from fpplab.core.errors import CapabilityError, SettingError
from fpplab.devices import Camera, Projector
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import Pattern
from fpplab.patterns.plan import Plan

CLOCK_TOLERANCE = 2e-4
"""Share by which the clocks of camera and projector may differ: 100 ppm each, of plain quartzes."""
UNKNOWN_DEAD_S = 1e-3
"""Time in s after an exposure in which a camera that reports no period may ignore a pulse (chosen)."""


class PeriodLimit(StrEnum):
    """What keeps patterns from following each other faster."""

    SETTLING = "the plan's exposure and settle_s"  # a stepped plan, in which nothing follows by itself
    EXPOSURE = "exposure and readout"  # the camera is ready as soon as its last row is exposed
    CAMERA = "the period reported by the camera"  # the camera takes no trigger before
    STATED = "the rig file's dead_time_s"  # what the camera needs beyond what it reports
    UNTOLD = "the time allowed for a camera that reports no period"
    """The camera reports nothing, and the rig file states nothing."""
    GAP = "the projector's minimum gap"  # the projector needs more time between patterns than the camera
    LOADS = "images that are read from the projector's flash"  # the next image is not there before


@dataclass(frozen=True)
class PulseTiming:
    """Times of a run."""

    light_s: float  # s that each pattern is shown
    dark_s: float  # least s of darkness after each
    period_s: float  # least s from one trigger pulse to the next
    limit: PeriodLimit  # what keeps the period from being shorter


def pulse_timing(
    camera: Camera,
    projector: Projector,
    patterns: Sequence[Pattern],
    exposure_s: float,
    dead_s: float | None = None,
    gap_s: float = 0.0,
) -> PulseTiming:
    """Decide the times of a triggered run from what the devices say."""
    caps, shown = camera.caps, projector.caps
    if "hardware" not in caps.triggers:
        raise CapabilityError(camera.name, "arm", "has no hardware trigger", "use a stepped plan")
    if not shown.trigger_outputs:
        raise CapabilityError(projector.name, "play", "has no trigger output", "use a stepped plan")
    if caps.dark_s and not shown.dark_between:
        raise CapabilityError(
            projector.name,
            "play",
            "there is no dark time between its patterns, and the rows of a camera with global reset end one "
            f"after another, within {1e3 * caps.dark_s:.6g} ms",
            "use patterns in flash, or a rolling shutter",
        )
    light_s = exposure_s + caps.readout_s
    _check_light(camera, projector, patterns, exposure_s)
    end_s = light_s + caps.dark_s
    periods_s = {PeriodLimit.EXPOSURE: end_s, PeriodLimit.LOADS: projector.loads.period_s}
    for limit, ready_s in _ready(caps.period_s, end_s, dead_s).items():
        periods_s[limit] = ready_s * (1 + CLOCK_TOLERANCE)
    limit = max(periods_s, key=lambda reason: periods_s[reason])
    period_s = max(periods_s[limit] + gap_s, end_s, projector.loads.period_s)  # the projector waits for these
    if light_s < period_s < light_s + shown.gap_s:
        limit, period_s = PeriodLimit.GAP, light_s + shown.gap_s
    return PulseTiming(light_s, caps.dark_s, period_s, limit)


def _ready(reported_s: float | None, end_s: float, dead_s: float | None) -> dict[PeriodLimit, float]:
    """Earliest next pulse that the camera takes, by source: s from the last pulse, by the camera's clock."""
    if reported_s is None and dead_s is None:
        return {PeriodLimit.UNTOLD: end_s + UNKNOWN_DEAD_S}
    times_s = {} if reported_s is None else {PeriodLimit.CAMERA: reported_s}
    # A stated time of 0 says nothing about a camera that reports its period.
    return times_s | (
        {PeriodLimit.STATED: end_s + dead_s} if dead_s or (reported_s is None and dead_s == 0) else {}
    )


def planned_timing(rig: Rig, plan: Plan, patterns: Sequence[Pattern], exposure_s: float) -> PulseTiming:
    """Decide the times of a plan's frames, stepped or triggered."""
    if plan.trigger == "triggered":
        return pulse_timing(
            rig.camera, rig.projector, patterns, exposure_s, rig.file.camera.dead_s(exposure_s)
        )
    check_stepped(rig.camera)
    step_s = plan.settle_s + exposure_s + rig.camera.caps.readout_s
    return PulseTiming(step_s, 0.0, step_s, PeriodLimit.SETTLING)


def check_stepped(camera: Camera) -> None:
    """Refuse a camera that cannot take a pattern which stays lit after the exposure."""
    if camera.caps.dark_s:
        raise CapabilityError(
            camera.name,
            "snap",
            "its rows end one after another (global reset), and a stepped pattern stays lit meanwhile",
            "set its shutter to rolling, or use a triggered plan",
        )


def _check_light(
    camera: Camera, projector: Projector, patterns: Sequence[Pattern], exposure_s: float
) -> None:
    """Refuse an exposure for which the projector cannot show its patterns."""
    caps, readout_s = projector.caps, camera.caps.readout_s
    bits = max((p.bit_depth for p in patterns), key=lambda depth: caps.bit_depths[depth])
    min_exposure_s = caps.bit_depths[bits]
    needed = f"exposure {1e3 * exposure_s:.6g} ms"
    if readout_s:
        needed += f" and readout {1e3 * readout_s:.6g} ms"
    if exposure_s + readout_s < min_exposure_s:
        raise SettingError(
            projector.name,
            "play",
            f"patterns would be shown for {needed}",
            f"with {bits} bits at least {1e3 * min_exposure_s:.6g} ms: lengthen the plan's exposure_s",
        )
    if exposure_s + readout_s > caps.longest_s:
        raise SettingError(
            projector.name,
            "play",
            f"patterns would be shown for {needed}",
            f"at most {1e3 * caps.longest_s:.6g} ms: shorten the plan's exposure_s, or use a stepped plan",
        )
