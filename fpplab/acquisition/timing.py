"""Times of a triggered run: how long each pattern is shown, and how far its trigger pulses are apart.

The projector is the clock, and a camera ignores a pulse that comes before it is ready. So what the camera
says of itself decides: exposure, readout, and the period at which it takes pulses. What it does not say is
allowed for, or stated in the rig file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fpplab.core.errors import CapabilityError, SettingError
from fpplab.devices import Camera, Projector
from fpplab.patterns.fringes import Pattern

CLOCK_TOLERANCE = 2e-4
"""By how much the clocks of camera and projector may differ, as a share: 100 ppm each, of plain quartzes."""
UNKNOWN_DEAD_S = 1e-3
"""Time in s after each exposure in which a camera that does not tell its period may ignore a pulse."""


@dataclass(frozen=True)
class PulseTiming:
    """Times of a triggered run.

    Attributes
    ----------
    light_s : float
        s that each pattern is shown.
    dark_s : float
        Least s of darkness after each.
    period_s : float
        Least s from one trigger pulse to the next.
    """

    light_s: float
    dark_s: float
    period_s: float


def pulse_timing(
    camera: Camera,
    projector: Projector,
    patterns: Sequence[Pattern],
    exposure_s: float,
    dead_s: float | None = None,
    gap_s: float = 0.0,
) -> PulseTiming:
    """Decide the times of a triggered run from what the devices say.

    Parameters
    ----------
    camera : Camera
        The camera, configured for the run.
    projector : Projector
        The projector.
    patterns : sequence of Pattern
        What is to be shown; at least one.
    exposure_s : float
        The camera's exposure in s, as read back.
    dead_s : float, optional
        Stated time in s after each exposure in which the camera ignores pulses; it counts where it is longer
        than the camera tells.
    gap_s : float
        Further s between pulses.

    Returns
    -------
    PulseTiming
        The times, for `Projector.play`.

    Raises
    ------
    CapabilityError
        The camera has no hardware trigger, or the projector no trigger output.
    SettingError
        A pattern cannot be shown for so short or so long a time.
    """
    caps, shown = camera.caps, projector.caps
    if "hardware" not in caps.triggers:
        raise CapabilityError(camera.name, "arm", "has no hardware trigger", "use a stepped plan")
    if not shown.trigger_outputs:
        raise CapabilityError(projector.name, "play", "has no trigger output", "use a stepped plan")
    light_s = exposure_s + caps.readout_s
    _check_light(camera, projector, patterns, exposure_s)
    end_s = light_s + caps.dark_s
    if caps.period_s is None:
        ready_s = end_s + (UNKNOWN_DEAD_S if dead_s is None else dead_s)
    else:
        ready_s = max(caps.period_s, end_s + dead_s if dead_s else 0.0)
    period_s = max(end_s, ready_s * (1 + CLOCK_TOLERANCE)) + gap_s
    if period_s > light_s:
        period_s = max(period_s, light_s + shown.gap_s)
    return PulseTiming(light_s, caps.dark_s, period_s)


def check_stepped(camera: Camera) -> None:
    """Refuse a camera that cannot take a pattern which stays lit after the exposure.

    Parameters
    ----------
    camera : Camera
        The camera, configured for the run.

    Raises
    ------
    CapabilityError
        Its rows end one after another.
    """
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
    least_s = caps.bit_depths[bits]
    needed = f"exposure {1e3 * exposure_s:.6g} ms"
    if readout_s:
        needed += f" and readout {1e3 * readout_s:.6g} ms"
    if exposure_s + readout_s < least_s:
        raise SettingError(
            projector.name,
            "play",
            f"patterns would be shown for {needed}",
            f"with {bits} bits at least {1e3 * least_s:.6g} ms: lengthen the plan's exposure_s",
        )
    if exposure_s + readout_s > caps.longest_s:
        raise SettingError(
            projector.name,
            "play",
            f"patterns would be shown for {needed}",
            f"at most {1e3 * caps.longest_s:.6g} ms: shorten the plan's exposure_s, or use a stepped plan",
        )
