"""Checks other than of the frames' content: permissions, the camera's link, the disk, mains flicker."""

import math
import re
import time
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fpplab.acquisition.acquire import expose
from fpplab.core.conventions import Floats, Image, full_scale
from fpplab.core.errors import CapabilityError, DeviceError
from fpplab.core.robust import robust_spread
from fpplab.devices import CameraSettings, DeviceInfo, Frame
from fpplab.devices.rig import Rig
from fpplab.diagnosis import Finding
from fpplab.diagnosis.causes.bands import BANDS
from fpplab.diagnosis.causes.flicker import FLICKER
from fpplab.diagnosis.causes.of_rig_check import DEVICE, MAINS_FLICKER, NO_PERMISSION, SLOW_DISK, SLOW_LINK
from fpplab.patterns.fringes import uniform_patterns
from fpplab.patterns.plan import Plan
from fpplab.sessions.session import Session
from fpplab.setup.rig_check.marker import middle_level

DECISIVE_EXCESS = 1e4
"""Excess of a finding from which everything else follows. Chosen: ranks before any measured one."""

REFUSED = re.compile(r"permission|not permitted|may not open|access (is )?denied|errno 13\b", re.IGNORECASE)
"""How systems and libraries say that a user may not open a device."""

SPEED = re.compile(r"([\d.]+) ([MG])bit/s")  # the rate of a link as drivers state it


@dataclass(frozen=True)
class DeviceCheckLimits:
    """From when on links, disk and light are at fault."""

    usable_share: float = 0.67  # of a link's rate that carries pixels: USB 2 of 480 Mbit/s carries 40 MB/s
    written: int = 6  # frames that are written to measure the disk; chosen
    mains_hz: tuple[float, ...] = (100.0, 120.0)  # of light from mains of 50 and 60 Hz
    frames: int = 16  # of each exposure by which flicker is measured; chosen
    min_scatter: float = 0.015  # of the frames' brightness that is flicker; chosen
    min_mains_scatter: float = 0.0075  # the same if whole periods reduce it, as nothing else does; chosen
    max_calm_share: float = 0.4  # of the scatter left by whole periods; random light keeps all of it; chosen


LIMITS = DeviceCheckLimits()


def device_finding(error: DeviceError) -> Finding:
    evidence = f"{error.device}: {error.operation}: {error.found} ({type(error).__name__})"
    if isinstance(error.__cause__, PermissionError) or REFUSED.search(error.found):
        return Finding(NO_PERMISSION, evidence, DECISIVE_EXCESS)
    return Finding(DEVICE, evidence, DECISIVE_EXCESS, error.remedy)


def link_finding(info: DeviceInfo, frame_bytes: float, period_s: float) -> Finding | None:
    stated = SPEED.search(info.link)
    if stated is None:
        return None
    bytes_per_s = LIMITS.usable_share * float(stated[1]) * {"M": 1e6, "G": 1e9}[stated[2]] / 8.0
    carried_hz, wanted_hz = bytes_per_s / frame_bytes, 1.0 / period_s
    if carried_hz >= wanted_hz:
        return None
    evidence = (
        f"the camera is connected by {info.link}, which carries {carried_hz:.1f} frames of "
        f"{frame_bytes / 1e6:.1f} MB per s; the plan takes {wanted_hz:.1f} (at most {carried_hz:.1f})"
    )
    return Finding(SLOW_LINK, evidence, wanted_hz / carried_hz)


def disk_finding(
    folder: Path, plan: Plan, frame: Image, settings: CameraSettings, period_s: float
) -> Finding | None:
    # frame (height, width)
    if plan.trigger != "triggered":
        return None
    count = min(LIMITS.written, plan.images)
    ids = [name for _, _, name in plan.steps()]
    with TemporaryDirectory(prefix=".fpplab-check-", dir=folder) as place:
        session = Session.create(Path(place) / "disk", plan)
        began = time.perf_counter()
        for k in range(count):
            session.write(Frame(frame, k, settings, time.time(), pattern_id=ids[k]))
        written_hz = count / (time.perf_counter() - began)
    wanted_hz = 1.0 / period_s
    if written_hz >= wanted_hz:
        return None
    evidence = (
        f"{folder} takes {written_hz:.1f} frames per s; the plan takes {wanted_hz:.1f} "
        f"(at most {written_hz:.1f})"
    )
    return Finding(SLOW_DISK, evidence, wanted_hz / written_hz)


def mains_finding(rig: Rig, plan: Plan) -> Finding | None:
    """Look for light at the mains' frequency: unlike random flicker, exposures of whole periods reduce it."""
    flicker = _brightness_scatter(rig, plan, plan.exposure_s)
    if flicker is None or flicker <= LIMITS.min_mains_scatter:
        return None
    by_exposure: list[tuple[float, float, float]] = []
    for hertz in LIMITS.mains_hz:
        exposure_s = max(1, round(plan.exposure_s * hertz)) / hertz
        if (scatter := _brightness_scatter(rig, plan, exposure_s)) is not None:
            by_exposure.append((scatter, exposure_s, hertz))
    scatter, exposure_s, hertz = min(by_exposure, default=(math.inf, 0.0, 0.0))
    if scatter > LIMITS.max_calm_share * flicker:
        return None
    evidence = (
        f"frames differ in brightness by {100 * flicker:.1f} % RMS, and by {100 * scatter:.1f} % where "
        f"they are exposed for {1e3 * exposure_s:.4g} ms, whole periods of light of {hertz:g} Hz (at most "
        f"{100 * LIMITS.min_mains_scatter:g} %)"
    )
    return Finding(
        MAINS_FLICKER,
        evidence,
        flicker / LIMITS.min_mains_scatter,
        f"write `exposure_s: {exposure_s:.5g}` into the plan, or run the lamp from direct current",
    )


def does_light_flicker(rig: Rig, plan: Plan) -> bool:
    """Return whether the light flickers, by frames of one grey level, which no slip changes."""
    levels = _mean_frame_levels(rig, plan, plan.exposure_s)
    if levels is None:
        return False
    middle = float(np.median(levels))
    return robust_spread(levels - middle, 0.0) > LIMITS.min_scatter * middle


def with_mains(findings: Sequence[Finding], mains: Finding | None) -> tuple[Finding, ...]:
    if mains is None:
        return tuple(findings)
    flickering = [finding.excess for finding in findings if finding.cause in (FLICKER, BANDS)]
    first = replace(mains, excess=max([1.01 * excess for excess in flickering], default=mains.excess))
    return tuple(sorted([first, *findings], key=lambda finding: -finding.excess))


def _brightness_scatter(rig: Rig, plan: Plan, exposure_s: float) -> float | None:
    """Standard deviation of the frames' brightness as a share; None where they saturate."""
    levels = _mean_frame_levels(rig, plan, exposure_s)
    return None if levels is None else float(np.std(levels, ddof=1) / np.mean(levels))


def _mean_frame_levels(rig: Rig, plan: Plan, exposure_s: float) -> Floats | None:
    """Mean levels (frames,) of frames of one grey level; None where they saturate or are not shown."""
    patterns = uniform_patterns([middle_level()] * LIMITS.frames, rig.projector.caps.size)
    settings = rig.camera_settings(exposure_s, plan.bits)
    stepped = plan.model_copy(update={"trigger": "stepped"})
    top, levels = full_scale(settings.bits), []
    with suppress(CapabilityError), closing(expose(rig, patterns, settings, stepped)) as shots:
        for shot in shots:
            if float((shot.image >= top).mean()) > 0.01:
                return None
            levels.append(float(shot.image.mean()))
    return np.array(levels) if levels else None
