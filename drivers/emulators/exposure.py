"""Light in the time of an emulated bench: what leaves the projector, and what an open shutter collects."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.clock import SteppedClock
from drivers.emulators.dlpc350 import Dlpc350, ProjectedLight
from fpplab.devices import CameraSettings

NEVER = float("inf")
HISTORY_S = 1.0
"""How far back light is known, beyond what is being exposed."""
ROUNDING_S = 1e-7
"""A shutter that closes this late, by rounding alone, is closed in time for the next pulse."""

CollectedLight = list[tuple[ProjectedLight, float]]
"""What a shutter saw: each light, and the share of the exposure in which it was on; the rest was dark."""


@dataclass(frozen=True)
class LightInterval:
    """What left the lens from one moment to another; None in the dark."""

    light: ProjectedLight | None
    begin_s: float
    end_s: float


class BenchClock(SteppedClock):
    """The time of a bench: whoever sleeps, what is due meanwhile happens, all in order and each at its time.

    controller: of the projector. on_passed: told of every interval of time. lock: held while time goes on.
    """

    controller: Dlpc350

    def __init__(self) -> None:
        super().__init__()
        self.lock = threading.RLock()
        self.on_interval: Callable[[LightInterval], None] = lambda interval: None

    def sleep(self, seconds: float) -> None:
        """Make it that much later."""
        self.sleep_until(self.now() + seconds)

    def sleep_until(self, time_s: float) -> None:
        """Make it that late, unless it is later."""
        with self.lock:
            while self._now_s < time_s:
                light = self.controller.light()
                begin_s, self._now_s = self._now_s, min(time_s, self.next_change_s())
                self.on_interval(LightInterval(light, begin_s, self._now_s))

    def next_change_s(self) -> float:
        """Let happen what is due now, and tell when the light may change by itself."""
        self.controller.advance()
        sequencer = self.controller.sequencer
        ends_s = sequencer.shown.illuminated_until_s if sequencer.shown else None
        return min(
            (s for s in (sequencer.next_s, ends_s) if s is not None and s > self._now_s), default=NEVER
        )


@dataclass(frozen=True)
class Exposure:
    """The shutter is open from one moment to another, with the camera set so."""

    settings: CameraSettings
    begin_s: float
    end_s: float


class EmulatedShutter:
    """Opened by pulses; while it is open it takes no notice of them. Each exposure waits to be read out."""

    def __init__(self, clock: BenchClock) -> None:
        self._clock = clock
        self._past: deque[LightInterval] = deque()
        self._exposures: deque[Exposure] = deque()
        clock.on_interval = self._record
        self.clear()

    def clear(self) -> None:
        """Forget what was exposed, and be closed."""
        self._exposures.clear()
        self._closes_s = -NEVER

    def open(self, settings: CameraSettings, begin_s: float, times: int = 1) -> None:
        """Expose from a moment on, unless it is open then; `times` for as many equal frames."""
        if begin_s < self._closes_s - ROUNDING_S:
            return
        self._closes_s = begin_s + settings.exposure_s
        self._exposures.extend([Exposure(settings, begin_s, self._closes_s)] * times)

    def wait_next(self, patience_s: float) -> tuple[CameraSettings, CollectedLight] | None:
        """Let time pass until an exposure is over, and read it out; None when none begins so soon."""
        clock = self._clock
        with clock.lock:
            deadline_s = clock.now() + patience_s
            while True:
                next_change_s = clock.next_change_s()
                if self._exposures:
                    break
                if clock.now() >= deadline_s:
                    return None
                clock.sleep_until(min(next_change_s, deadline_s))
            clock.sleep_until(self._exposures[0].end_s)
            exposure = self._exposures.popleft()
            return exposure.settings, self._collect(exposure)

    def expose_now(self, settings: CameraSettings) -> CollectedLight:
        """What it collects when it is opened now."""
        with self._clock.lock:
            begin_s = self._clock.now()
            exposure = Exposure(settings, begin_s, begin_s + settings.exposure_s)
            self._clock.sleep_until(exposure.end_s)
            return self._collect(exposure)

    def _record(self, interval: LightInterval) -> None:
        past = self._past
        if past and _same_light(past[-1].light, interval.light):
            past[-1] = replace(past[-1], end_s=interval.end_s)
        else:
            past.append(interval)
        needed_s = min([interval.end_s - HISTORY_S, *(exposure.begin_s for exposure in self._exposures)])
        while past[0].end_s < needed_s:
            past.popleft()

    def _collect(self, exposure: Exposure) -> CollectedLight:
        found = []
        for interval in self._past:
            open_s = min(interval.end_s, exposure.end_s) - max(interval.begin_s, exposure.begin_s)
            if interval.light is not None and open_s > 0:
                found.append((interval.light, open_s / (exposure.end_s - exposure.begin_s)))
        return found


def _same_light(a: ProjectedLight | None, b: ProjectedLight | None) -> bool:
    """Whether both light the scene alike; frames of a video port come as ever new arrays."""
    if a is None or b is None:
        return a is b
    kinds = [(light.depth, light.number, light.inverted, light.levels) for light in (a, b)]
    return kinds[0] == kinds[1] and (a.content is b.content or np.array_equal(a.content, b.content))


def mean_grey_levels(collected: CollectedLight) -> NDArray[np.uint8] | None:
    """The grey levels whose light is the mean of what was collected, uint8 (height, width); None for none.

    At full LED levels one pattern that was on all the time gives exactly its own; anything else is rounded.
    """
    if not collected:
        return None
    light = sum(share * light.brightness() for light, share in collected)
    return np.asarray(np.rint(255.0 * light), np.uint8)
