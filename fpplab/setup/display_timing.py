"""How late a projector shows what it is told, and how long it refreshes: both measured with the camera."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import full_scale
from fpplab.core.errors import DeviceError
from fpplab.core.progress import Progress
from fpplab.devices import FlashingProjector
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import uniform_patterns
from fpplab.patterns.plan import Plan
from fpplab.setup.rig_check.marker_check import LEAST_RISE

BLACK, GREY = 0, 1
"""The two patterns that are shown."""
WAITS_S = (0.0, 0.004, 0.008, 0.016, 0.032, 0.064, 0.128, 0.256, 0.512, 1.0)
"""Waits in s that are tried, one after another, until one is long enough."""
RESOLUTION_S = 0.002
"""How well the least wait is found, in s."""
REST_S = 0.3
"""How long a pattern stays before the next in s, at least."""
MISSING = 0.05
"""Share of the change in brightness that may be missing from a frame."""
TRIALS = 3
"""How often a wait must suffice, in both directions; and how many flashes are measured."""
GREYS = (255, 192, 128, 96, 64, 48, 32, 24, 16)
"""Grey levels that are tried until the camera is not saturated."""
REFRESHES = 6
"""Refreshes of a flash."""
SLACK_S = 0.1
"""Time in s before a flash in which the camera begins to expose, and again after it."""
SATURATED = 0.001
"""Share of pixels at full scale beyond which levels do not count."""
MOST_APART = 0.1
"""Share by which the refresh that is seen may differ from the one that the display tells."""


@dataclass(frozen=True)
class DisplayTiming:
    """Times of a projector."""

    settle_s: float  # least time in s after `Projector.show` until a frame shows the new pattern alone
    refresh_s: float | None  # refresh period in s, as the camera measured it
    told_s: float | None  # the same as the display tells it

    @property
    def agrees(self) -> bool:
        """Whether the refresh that the camera saw is the one that the display tells."""
        if self.refresh_s is None or self.told_s is None:
            return True
        return abs(self.refresh_s / self.told_s - 1.0) <= MOST_APART

    def summary(self) -> dict[str, Any]:
        """Give the times as plain values."""
        return {**asdict(self), "agrees": self.agrees}


def measure_display(rig: Rig, plan: Plan, progress: Progress) -> DisplayTiming:
    """Measure how late the projector of a rig shows a pattern, and its refresh period where it has one."""
    try:
        settle_s = _Levels(rig, plan, plan.exposure_s).settling_s(lambda share: progress(0.7 * share))
        projector = rig.projector
        if not isinstance(projector, FlashingProjector):
            return DisplayTiming(settle_s, None, None)
        exposure_s = REFRESHES * projector.refresh_s + settle_s + 2 * SLACK_S
        told_s = projector.refresh_s
        if exposure_s > rig.camera.caps.exposure_s[1]:
            return DisplayTiming(settle_s, None, told_s)
        refresh_s = _Levels(rig, plan, exposure_s).refresh_s(projector, settle_s)
        return DisplayTiming(settle_s, refresh_s, told_s)
    finally:
        progress(1.0)
        rig.make_dark()


class _Levels:
    """Brightness of frames as a share of the way from black to the pattern, at one exposure."""

    def __init__(self, rig: Rig, plan: Plan, exposure_s: float) -> None:
        self._rig = rig
        self._exposure_s = rig.camera.configure(rig.camera_settings(exposure_s, plan.bits)).exposure_s
        self._full = full_scale(rig.camera_settings(exposure_s, plan.bits).bits)
        for grey in GREYS:
            rig.projector.load(uniform_patterns([0, grey], rig.projector.caps.size))
            self._black, lit = (self._after(i, WAITS_S[-1]) for i in (BLACK, GREY))
            change = lit - self._black
            if (lit >= self._full).mean() <= SATURATED or grey == GREYS[-1]:
                break
        self._lit = change >= 0.5 * np.quantile(change, 0.95)
        self._range = float(change[self._lit].mean())
        if not self._range >= LEAST_RISE * self._full:
            share = 100 * self._range / self._full
            raise DeviceError(
                rig.camera.name,
                "timing",
                f"a pattern of grey level {grey} is brighter than black by {share:.2g} % of full scale",
                "check lens caps, the projector's light, where both look, and the plan's exposure_s",
            )

    def settling_s(self, progress: Progress) -> float:
        """Give the least wait that suffices."""
        for k, wait_s in enumerate(WAITS_S):
            progress(k / len(WAITS_S))
            if self._suffices(wait_s):
                break
        else:
            raise DeviceError(
                self._rig.projector.name,
                "timing",
                f"frames still show the pattern before, {WAITS_S[-1]:g} s after it was replaced",
                "make sure that nothing else drives the projector, and switch its picture processing off",
            )
        if k == 0:
            return 0.0
        short_s, long_s = WAITS_S[k - 1], wait_s
        while long_s - short_s > max(RESOLUTION_S, 0.05 * long_s):
            middle_s = 0.5 * (short_s + long_s)
            short_s, long_s = (short_s, middle_s) if self._suffices(middle_s) else (middle_s, long_s)
        return long_s

    def refresh_s(self, projector: FlashingProjector, settle_s: float) -> float:
        """Give the refresh period: the light of a flash, as a share of that of the whole exposure."""
        periods = []
        with ThreadPoolExecutor(max_workers=1) as camera:
            for _ in range(TRIALS):
                self._show(BLACK, REST_S + settle_s)
                frame = camera.submit(self._level)
                time.sleep(SLACK_S)
                projector.flash(GREY, REFRESHES)
                periods.append(frame.result() * self._exposure_s / REFRESHES)
        return float(np.median(periods))

    def _suffices(self, wait_s: float) -> bool:
        """Whether frames so long after a pattern show it alone, from dark to bright and back."""
        for _ in range(TRIALS):
            for before, after in ((BLACK, GREY), (GREY, BLACK)):
                self._show(before, max(REST_S, 2 * wait_s))
                self._show(after, wait_s)
                if abs(self._level() - after) > MISSING:
                    return False
        return True

    def _level(self) -> float:
        """0 for black, 1 for the pattern."""
        image = self._frame()
        return float((image - self._black)[self._lit].mean()) / self._range

    def _show(self, i: int, wait_s: float) -> None:
        self._rig.projector.show(i)
        time.sleep(wait_s)

    def _after(self, i: int, wait_s: float) -> NDArray[np.float64]:
        self._show(i, wait_s)
        return self._frame()

    def _frame(self) -> NDArray[np.float64]:
        return self._rig.camera.snap(self._exposure_s + 10.0).image.astype(np.float64)
