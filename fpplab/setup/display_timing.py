"""Latency and refresh period of a projector, both measured with the camera."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
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
from fpplab.setup.rig_check.marker_check import LIMITS as MARKER_LIMITS

BLACK, GREY = 0, 1  # the two patterns that are shown


@dataclass(frozen=True)
class DisplayTimingLimits:
    """How the times of a projector are measured; all chosen."""

    # Waits and grey levels are tried in turn, until the wait suffices and until the camera is not saturated.
    waits_s: tuple[float, ...] = (0.0, 0.004, 0.008, 0.016, 0.032, 0.064, 0.128, 0.256, 0.512, 1.0)
    greys: tuple[int, ...] = (255, 192, 128, 96, 64, 48, 32, 24, 16)
    resolution_s: float = 0.002  # of the wait that is found
    rest_s: float = 0.3  # for which a pattern is shown at least before the next
    max_missing: float = 0.05  # share of the change in brightness that may be missing from a frame
    trials: int = 3  # for which a wait must suffice in both directions; flashes that are measured
    refreshes: int = 6  # of a flash
    slack_s: float = 0.1  # of the exposure before a flash, and again after it
    max_saturated: float = 0.001  # share of pixels at full scale
    max_difference: float = 0.1  # of measured and stated refresh period, as a share


LIMITS = DisplayTimingLimits()


@dataclass(frozen=True)
class DisplayTiming:
    """Times of a projector."""

    settle_s: float  # shortest time in s from `Projector.show` to a frame of the new pattern alone
    refresh_s: float | None  # refresh period in s, as the camera measured it
    reported_s: float | None  # the same as stated by the display

    @property
    def agrees(self) -> bool:
        if self.refresh_s is None or self.reported_s is None:
            return True
        return abs(self.refresh_s / self.reported_s - 1.0) <= LIMITS.max_difference

    def summary(self) -> dict[str, Any]:
        return {
            "settle_s": self.settle_s,
            "refresh_s": self.refresh_s,
            "told_s": self.reported_s,
            "agrees": self.agrees,
        }


def measure_display(rig: Rig, plan: Plan, progress: Progress) -> DisplayTiming:
    try:
        settle_s = _Levels(rig, plan, plan.exposure_s).settling_s(lambda share: progress(0.7 * share))
        projector = rig.projector
        if not isinstance(projector, FlashingProjector):
            return DisplayTiming(settle_s, None, None)
        exposure_s = LIMITS.refreshes * projector.refresh_s + settle_s + 2 * LIMITS.slack_s
        reported_s = projector.refresh_s
        if exposure_s > rig.camera.caps.exposure_s[1]:
            return DisplayTiming(settle_s, None, reported_s)
        refresh_s = _Levels(rig, plan, exposure_s).refresh_s(projector, settle_s)
        return DisplayTiming(settle_s, refresh_s, reported_s)
    finally:
        progress(1.0)
        rig.make_dark()


class _Levels:
    """Brightness of frames as a share of the way from black to the pattern, at one exposure."""

    def __init__(self, rig: Rig, plan: Plan, exposure_s: float) -> None:
        self._rig = rig
        self._exposure_s = rig.camera.configure(rig.camera_settings(exposure_s, plan.bits)).exposure_s
        self._full = full_scale(rig.camera_settings(exposure_s, plan.bits).bits)
        for grey in LIMITS.greys:
            rig.projector.load(uniform_patterns([0, grey], rig.projector.caps.size))
            self._black, lit = (self._after(i, LIMITS.waits_s[-1]) for i in (BLACK, GREY))
            change = lit - self._black
            if (lit >= self._full).mean() <= LIMITS.max_saturated or grey == LIMITS.greys[-1]:
                break
        self._lit = change >= 0.5 * np.quantile(change, 0.95)
        self._range = float(change[self._lit].mean())
        if not self._range >= MARKER_LIMITS.min_rise * self._full:
            share = 100 * self._range / self._full
            raise DeviceError(
                rig.camera.name,
                "timing",
                f"a pattern of grey level {grey} is brighter than black by {share:.2g} % of full scale",
                "check lens caps, the projector's light, where both look, and the plan's exposure_s",
            )

    def settling_s(self, progress: Progress) -> float:
        for k, wait_s in enumerate(LIMITS.waits_s):
            progress(k / len(LIMITS.waits_s))
            if self._suffices(wait_s):
                break
        else:
            raise DeviceError(
                self._rig.projector.name,
                "timing",
                f"frames still show the pattern before, {LIMITS.waits_s[-1]:g} s after it was replaced",
                "make sure that nothing else drives the projector, and switch off its picture processing",
            )
        if k == 0:
            return 0.0
        short_s, long_s = LIMITS.waits_s[k - 1], wait_s
        while long_s - short_s > max(LIMITS.resolution_s, 0.05 * long_s):
            middle_s = 0.5 * (short_s + long_s)
            short_s, long_s = (short_s, middle_s) if self._suffices(middle_s) else (middle_s, long_s)
        return long_s

    def refresh_s(self, projector: FlashingProjector, settle_s: float) -> float:
        periods = []
        with ThreadPoolExecutor(max_workers=1) as camera:
            for _ in range(LIMITS.trials):
                self._show(BLACK, LIMITS.rest_s + settle_s)
                frame = camera.submit(self._level)
                time.sleep(LIMITS.slack_s)
                projector.flash(GREY, LIMITS.refreshes)
                periods.append(frame.result() * self._exposure_s / LIMITS.refreshes)
        return float(np.median(periods))

    def _suffices(self, wait_s: float) -> bool:
        for _ in range(LIMITS.trials):
            for before, after in ((BLACK, GREY), (GREY, BLACK)):
                self._show(before, max(LIMITS.rest_s, 2 * wait_s))
                self._show(after, wait_s)
                if abs(self._level() - after) > LIMITS.max_missing:
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
