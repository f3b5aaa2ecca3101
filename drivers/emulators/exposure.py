"""Light in the time of an emulated bench: what the projector emits, and what an open shutter collects."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.clock import SteppedClock
from drivers.emulators.dlpc350 import Dlpc350, ProjectedLight
from drivers.emulators.sensor_timing import STRICT, SensorTiming
from fpplab.devices import CameraSettings

NEVER = float("inf")
"""Time of what never happens, in s."""
HISTORY_S = 1.0
"""How far back light is remembered in s, beyond what is being exposed."""
ROUNDING_S = 1e-9
"""A camera that is ready this late in s, by rounding alone, is ready in time for the next pulse."""

CollectedLight = list[tuple[ProjectedLight, float]]
"""What a shutter collected: each light and its share of the exposure time; the rest was dark."""


@dataclass(frozen=True)
class LightInterval:
    """Constant light from the projector during an interval of time.

    Attributes
    ----------
    light : ProjectedLight or None
        The light; None when it is dark.
    begin_s : float
        Beginning in s.
    end_s : float
        End in s.
    """

    light: ProjectedLight | None
    begin_s: float
    end_s: float


class BenchClock(SteppedClock):
    """The time of an emulated bench: whatever is due during a sleep happens, in order and each at its time.

    Attributes
    ----------
    controller : Dlpc350
        The projector's controller; to be set before time passes.
    lock : threading.RLock
        Held while time passes.
    on_interval : callable
        Called with every `LightInterval` that has passed.
    """

    controller: Dlpc350

    def __init__(self) -> None:
        super().__init__()
        self.lock = threading.RLock()
        self.on_interval: Callable[[LightInterval], None] = lambda interval: None

    def sleep(self, seconds: float) -> None:
        """Advance the time.

        Parameters
        ----------
        seconds : float
            By how much, in s.
        """
        self.sleep_until(self.now() + seconds)

    def sleep_until(self, time_s: float) -> None:
        """Advance to a time; without effect if it has passed.

        Parameters
        ----------
        time_s : float
            Time in s.
        """
        with self.lock:
            while self._now_s < time_s:
                light = self.controller.light()
                begin_s, self._now_s = self._now_s, min(time_s, self.next_change_s())
                self.on_interval(LightInterval(light, begin_s, self._now_s))

    def next_change_s(self) -> float:
        """Do what is due now, and return when the light may next change by itself.

        Returns
        -------
        float
            Time in s; `NEVER` if it does not.
        """
        self.controller.advance()
        sequencer = self.controller.sequencer
        ends_s = sequencer.shown.illuminated_until_s if sequencer.shown else None
        return min(
            (s for s in (sequencer.next_s, ends_s) if s is not None and s > self._now_s), default=NEVER
        )


@dataclass(frozen=True)
class Exposure:
    """One exposure of the camera.

    Attributes
    ----------
    settings : CameraSettings
        What the camera is set to.
    begin_s : float
        Time in s when the shutter opens.
    end_s : float
        Time in s when it closes.
    """

    settings: CameraSettings
    begin_s: float
    end_s: float


class EmulatedShutter:
    """The camera's shutter, opened by pulses; a pulse before the camera is ready has no effect.

    Exposures are queued until they are read out.

    Parameters
    ----------
    clock : BenchClock
        The bench's time; its `on_interval` is taken over.
    timing : SensorTiming
        When the camera is ready again.

    Attributes
    ----------
    ignored : int
        Number of pulses since the last `clear` that came too early.
    """

    def __init__(self, clock: BenchClock, timing: SensorTiming = STRICT) -> None:
        self._clock, self._timing = clock, timing
        self._past: deque[LightInterval] = deque()
        self._exposures: deque[Exposure] = deque()
        clock.on_interval = self._record
        self.clear()

    def clear(self) -> None:
        """Close the shutter and discard the exposures that were not read out."""
        self._exposures.clear()
        self._ready_s, self.ignored = -NEVER, 0

    def open(self, settings: CameraSettings, begin_s: float, times: int = 1) -> None:
        """Start an exposure, unless the camera is not ready at that time.

        Parameters
        ----------
        settings : CameraSettings
            What the camera is set to.
        begin_s : float
            Time in s when it opens.
        times : int
            Number of equal frames that it gives.
        """
        if begin_s < self._ready_s - ROUNDING_S:
            self.ignored += 1
            return
        self._ready_s = begin_s + self._timing.period_s(settings.exposure_s)
        self._exposures.extend([Exposure(settings, begin_s, begin_s + settings.exposure_s)] * times)

    def wait_next(self, patience_s: float) -> tuple[CameraSettings, CollectedLight] | None:
        """Let time pass until an exposure is over, and read it out.

        Parameters
        ----------
        patience_s : float
            How long to wait in s for it to begin.

        Returns
        -------
        (CameraSettings, CollectedLight) or None
            Settings of the exposure and what it collected; None if none begins in time.
        """
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
        """Make an exposure that begins now, and let its time pass.

        Parameters
        ----------
        settings : CameraSettings
            What the camera is set to.

        Returns
        -------
        CollectedLight
            What the shutter collected.
        """
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
    """Return whether both illuminate the scene alike; frames of a video port are new arrays each time."""
    if a is None or b is None:
        return a is b
    kinds = [(light.depth, light.number, light.inverted, light.levels) for light in (a, b)]
    return kinds[0] == kinds[1] and (a.content is b.content or np.array_equal(a.content, b.content))


def mean_grey_levels(collected: CollectedLight) -> NDArray[np.uint8] | None:
    """Average the light that was collected, in grey levels of the projector.

    At full LED levels one pattern that was on all the time gives exactly its own grey levels; anything else
    is rounded.

    Parameters
    ----------
    collected : CollectedLight
        What the shutter collected.

    Returns
    -------
    numpy.ndarray or None
        uint8 (height, width); None if it was dark.
    """
    if not collected:
        return None
    light = sum(share * light.brightness() for light, share in collected)
    return np.asarray(np.rint(255.0 * light), np.uint8)
