"""Light in the time of an emulated bench: what the projector emits, and what an open shutter collects.

A trigger pulse that comes before the camera is ready is ignored, as real cameras do. An exposure may overlap
with the readout of the previous frame, but must not end before that readout does, and the sensor needs a dead
time between two exposures.
"""

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.clock import ROUNDING_S, SteppedClock
from drivers.emulators.dlpc350 import Dlpc350, ProjectedLight
from fpplab.core.config import Document
from fpplab.devices import CameraSettings

Microseconds = Annotated[float, Field(ge=0)]


class SensorTiming(Document):
    """Times of an emulated sensor; without options it is `STRICT`."""

    readout_us: Microseconds = 8000.0
    """Time in µs in which a frame is read out."""
    dead_us: Microseconds = 100.0
    """Time in µs between the end of an exposure, or of a readout, and the next."""
    untold_us: Microseconds = 0.0
    """Further dead time in µs, which the camera's resulting frame rate leaves out."""
    clock_ppm: Annotated[float, Field(ge=0, le=1000)] = 100.0
    """By how many millionths the camera's times are longer than it reports."""

    def reported_rate_hz(self, exposure_s: float) -> float:
        rate_hz = 1.0 / (max(exposure_s, self.readout_us * 1e-6) + self.dead_us * 1e-6)
        steps_per_hz = 100  # of the frame rate that pylon's emulator can report
        return max(int(rate_hz * steps_per_hz), 1) / steps_per_hz

    def period_s(self, exposure_s: float) -> float:
        """Compute the time from the beginning of an exposure until the camera takes the next pulse."""
        dead_s = (self.dead_us + self.untold_us) * 1e-6
        return (max(exposure_s, self.readout_us * 1e-6) + dead_s) * (1 + 1e-6 * self.clock_ppm)


STRICT = SensorTiming()
"""A sensor that needs time for readout and between exposures, by its slow clock more than it reports."""
ALWAYS_READY = SensorTiming(readout_us=0.0, dead_us=0.0, clock_ppm=0.0)
"""A sensor that takes the next pulse as soon as an exposure has ended; no camera does."""


NEVER = float("inf")  # time of what never happens, in s

CollectedLight = list[tuple[ProjectedLight, float]]
"""What a shutter collected: each light and its share of the exposure time; the rest was dark."""


@dataclass(frozen=True)
class LightInterval:
    """Constant light from the projector during an interval of time."""

    light: ProjectedLight | None  # the light; None when it is dark
    begin_s: float  # beginning in s
    end_s: float  # end in s


class BenchClock(SteppedClock):
    """The clock of an emulated bench: what is due during a sleep happens in order, at its time."""

    controller: Dlpc350  # the projector's controller; to be set before time passes

    def __init__(self) -> None:
        super().__init__()
        self.lock = threading.RLock()
        self.on_interval: Callable[[LightInterval], None] = lambda interval: None

    def sleep(self, seconds: float) -> None:
        self.sleep_until(self.now() + seconds)

    def sleep_until(self, time_s: float) -> None:
        """Advance to a time; without effect if it has passed."""
        with self.lock:
            while self._now_s < time_s:
                light = self.controller.light()
                begin_s, self._now_s = self._now_s, min(time_s, self.next_change_s())
                self.on_interval(LightInterval(light, begin_s, self._now_s))

    def next_change_s(self) -> float:
        """Do what is due now, and return when the light may next change by itself."""
        self.controller.advance()
        return min((s for s in self.controller.changes_s() if s > self._now_s), default=NEVER)


@dataclass(frozen=True)
class Exposure:
    """One exposure of the camera."""

    settings: CameraSettings  # what the camera is set to
    begin_s: float  # time in s when the shutter opens
    end_s: float  # time in s when it closes


class EmulatedShutter:
    """The camera's shutter: opened by pulses, but none before it is ready; exposures queue until read out."""

    def __init__(self, clock: BenchClock, timing: SensorTiming = STRICT) -> None:
        self._clock, self._timing = clock, timing
        self._past: deque[LightInterval] = deque()
        self._exposures: deque[Exposure] = deque()
        clock.on_interval = self._record_interval
        self.on_strobe: Callable[[bool], None] = lambda active: None
        """Called when an exposure that the computer orders begins and when it ends."""
        self.clear()

    def clear(self, buffers: float = math.inf) -> None:
        """Close the shutter and discard the exposures that were not read out."""
        self._exposures.clear()
        self.buffers = buffers
        self._ready_s, self.ignored = -NEVER, 0

    def open(self, settings: CameraSettings, begin_s: float, times: int = 1) -> None:
        """Start an exposure, unless the camera is not ready at that time."""
        if begin_s < self._ready_s - ROUNDING_S:
            self.ignored += 1
            return
        self._ready_s = begin_s + self._timing.period_s(settings.exposure_s)
        if len(self._exposures) >= self.buffers:  # nothing is free to take the frame
            return
        self._exposures.extend([Exposure(settings, begin_s, begin_s + settings.exposure_s)] * times)

    def wait_next(self, timeout_s: float) -> tuple[CameraSettings, CollectedLight] | None:
        """Let time pass until an exposure is over, and read it out."""
        clock = self._clock
        with clock.lock:
            deadline_s = clock.now() + timeout_s
            while True:
                next_change_s = clock.next_change_s()
                if self._exposures:
                    break
                if clock.now() >= deadline_s:
                    return None
                clock.sleep_until(min(next_change_s, deadline_s))
            clock.sleep_until(self._exposures[0].end_s)
            exposure = self._exposures.popleft()
            return exposure.settings, self._collect_light(exposure)

    def expose_now(self, settings: CameraSettings) -> CollectedLight:
        """Make an exposure that begins now, and let its time pass."""
        with self._clock.lock:
            begin_s = self._clock.now()
            exposure = Exposure(settings, begin_s, begin_s + settings.exposure_s)
            self.on_strobe(True)
            self._clock.sleep_until(exposure.end_s)
            self.on_strobe(False)
            return self._collect_light(exposure)

    def _record_interval(self, interval: LightInterval) -> None:
        past = self._past
        if past and _same_light(past[-1].light, interval.light):
            past[-1] = replace(past[-1], end_s=interval.end_s)
        else:
            past.append(interval)
        # 1 s (chosen) beyond what is being exposed: a pulse may be reported a little after its time.
        needed_s = min([interval.end_s - 1.0, *(exposure.begin_s for exposure in self._exposures)])
        while past[0].end_s < needed_s:
            past.popleft()

    def _collect_light(self, exposure: Exposure) -> CollectedLight:
        collected = []
        for interval in self._past:
            open_s = min(interval.end_s, exposure.end_s) - max(interval.begin_s, exposure.begin_s)
            if interval.light is not None and open_s > 0:
                collected.append((interval.light, open_s / (exposure.end_s - exposure.begin_s)))
        return collected


def _same_light(a: ProjectedLight | None, b: ProjectedLight | None) -> bool:
    """Return whether both illuminate the scene equally; frames of a video port are new arrays each time."""
    if a is None or b is None:
        return a is b
    kinds = [(light.depth, light.number, light.inverted, light.levels) for light in (a, b)]
    return kinds[0] == kinds[1] and (a.content is b.content or np.array_equal(a.content, b.content))


def mean_pattern(collected: CollectedLight) -> NDArray[np.uint8] | None:
    """Average the light that was collected, in grey levels of the projector."""
    # At full LED levels one pattern that was on all the time gives exactly its own grey levels; anything else
    # is rounded.
    # returns (height, width)
    if not collected:
        return None
    light = sum(share * light.brightness() for light, share in collected)
    return np.asarray(np.rint(255.0 * light), np.uint8)
