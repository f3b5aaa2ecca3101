"""What devices and disk tell beside their frames: permissions, the camera's link, writing, the mains."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import replace
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

RUINOUS = 1e4
"""Excess of a device that cannot be used: nothing else is known then."""

REFUSED = re.compile(r"permission|not permitted|may not open|access (is )?denied|errno 13\b", re.IGNORECASE)
"""How systems and libraries say that a user may not open a device."""

USABLE_SHARE = 0.67
"""Share of a link's rate that carries pixels: USB 2 of 480 Mbit/s carries 40 MB/s."""

SPEED = re.compile(r"([\d.]+) ([MG])bit/s")
"""The rate of a link as drivers state it."""

WRITTEN = 6
"""Frames that are written to measure the disk."""

MAINS_HZ = (100.0, 120.0)
"""Frequencies of light from mains of 50 and 60 Hz."""

MAINS_FRAMES = 16
"""Frames of each exposure that tell the mains."""

LEAST_SCATTER = 0.015
"""Scatter of the frames' brightness that flicker has."""

LEAST_MAINS = 0.0075
"""Scatter that is told where whole periods of the light calm it: nothing else looks alike."""

CALM_SHARE = 0.4
"""What whole periods of the light leave of its scatter, at most; random light is as restless as before."""


def device_finding(error: DeviceError) -> Finding:
    """Say what a device's error means."""
    seen = f"{error.device}: {error.operation}: {error.found} ({type(error).__name__})"
    if isinstance(error.__cause__, PermissionError) or REFUSED.search(error.found):
        return Finding(NO_PERMISSION, seen, RUINOUS)
    return Finding(DEVICE, seen, RUINOUS, error.remedy)


def link_finding(info: DeviceInfo, frame_bytes: float, period_s: float) -> Finding | None:
    """Compare what a camera's connection carries with what a plan takes."""
    stated = SPEED.search(info.link)
    if stated is None:
        return None
    bytes_per_s = USABLE_SHARE * float(stated[1]) * {"M": 1e6, "G": 1e9}[stated[2]] / 8.0
    carried, wanted = bytes_per_s / frame_bytes, 1.0 / period_s
    if carried >= wanted:
        return None
    words = (
        f"the camera is connected by {info.link}, which carries {carried:.1f} frames of "
        f"{frame_bytes / 1e6:.1f} MB per s; the plan takes {wanted:.1f} (at most {carried:.1f})"
    )
    return Finding(SLOW_LINK, words, wanted / carried)


def disk_finding(
    folder: Path, plan: Plan, frame: Image, settings: CameraSettings, period_s: float
) -> Finding | None:
    """Write some frames as a scan does, and compare the rate with that of a triggered plan."""
    # frame (height, width)
    if plan.trigger != "triggered":
        return None
    count = min(WRITTEN, plan.images)
    ids = [name for _, _, name in plan.steps()]
    with TemporaryDirectory(prefix=".fpplab-check-", dir=folder) as place:
        session = Session.create(Path(place) / "disk", plan)
        began = time.perf_counter()
        for k in range(count):
            session.write(Frame(frame, k, settings, time.time(), pattern_id=ids[k]))
        written = count / (time.perf_counter() - began)
    wanted = 1.0 / period_s
    if written >= wanted:
        return None
    words = f"{folder} takes {written:.1f} frames per s; the plan takes {wanted:.1f} (at most {written:.1f})"
    return Finding(SLOW_DISK, words, wanted / written)


def mains_finding(rig: Rig, plan: Plan) -> Finding | None:
    """Tell light at the mains' frequency from light that flickers at random: whole periods calm it."""
    restless = _scatter(rig, plan, plan.exposure_s)
    if restless is None or restless <= LEAST_MAINS:
        return None
    calm: list[tuple[float, float, float]] = []
    for hertz in MAINS_HZ:
        exposure_s = max(1, round(plan.exposure_s * hertz)) / hertz
        if (scatter := _scatter(rig, plan, exposure_s)) is not None:
            calm.append((scatter, exposure_s, hertz))
    scatter, exposure_s, hertz = min(calm, default=(math.inf, 0.0, 0.0))
    if scatter > CALM_SHARE * restless:
        return None
    words = (
        f"frames differ in brightness by {100 * restless:.1f} % RMS, and by {100 * scatter:.1f} % where "
        f"they are exposed for {1e3 * exposure_s:.4g} ms, whole periods of light of {hertz:g} Hz (at most "
        f"{100 * LEAST_MAINS:g} %)"
    )
    return Finding(
        MAINS_FLICKER,
        words,
        restless / LEAST_MAINS,
        f"write `exposure_s: {exposure_s:.5g}` into the plan, or run the lamp from direct current",
    )


def flickers(rig: Rig, plan: Plan) -> bool:
    """Tell whether the light flickers, by frames that all show one grey level: no slip changes these."""
    levels = _levels(rig, plan, plan.exposure_s)
    if levels is None:
        return False
    middle = float(np.median(levels))
    return robust_spread(levels - middle, 0.0) > LEAST_SCATTER * middle


def with_mains(findings: Sequence[Finding], mains: Finding | None) -> tuple[Finding, ...]:
    """Put the mains before the flicker that they cause."""
    if mains is None:
        return tuple(findings)
    flickering = [one.excess for one in findings if one.cause in (FLICKER, BANDS)]
    own = replace(mains, excess=max([1.01 * one for one in flickering], default=mains.excess))
    return tuple(sorted([own, *findings], key=lambda one: -one.excess))


def _scatter(rig: Rig, plan: Plan, exposure_s: float) -> float | None:
    """Standard deviation of the frames' brightness as a share; None where they saturate."""
    levels = _levels(rig, plan, exposure_s)
    return None if levels is None else float(np.std(levels, ddof=1) / np.mean(levels))


def _levels(rig: Rig, plan: Plan, exposure_s: float) -> Floats | None:
    """Mean levels (MAINS_FRAMES,) of frames of one grey level; None where they saturate or are not shown."""
    patterns = uniform_patterns([middle_level()] * MAINS_FRAMES, rig.projector.caps.size)
    settings = rig.camera_settings(exposure_s, plan.bits)
    stepped = plan.model_copy(update={"trigger": "stepped"})
    top, levels = full_scale(settings.bits), []
    with suppress(CapabilityError), closing(expose(rig, patterns, settings, stepped)) as shots:
        for shot in shots:
            if float((shot.image >= top).mean()) > 0.01:
                return None
            levels.append(float(shot.image.mean()))
    return np.array(levels) if levels else None
