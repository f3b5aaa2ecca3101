"""pylon's emulated camera as part of an emulated bench: exposed by its light and in its time."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from pypylon import genicam, pylon

from drivers.emulators.exposure import STRICT, CollectedLight, EmulatedShutter, SensorTiming
from drivers.emulators.pylon import READY_MS, EmulatedCamera, EmulatedPylon
from drivers.genicam.names import (
    LINE_INVERTER,
    TRIGGER_DELAY_US,
    TRIGGER_EDGE,
    TRIGGER_MODE,
    TRIGGER_SOURCE,
    US_PER_S,
)
from drivers.genicam.options import EDGES
from fpplab.core.conventions import Image, raw_dtype
from fpplab.devices import CameraSettings
from fpplab.patterns.mosaic import Bayer

MIN_SENSOR_SIZE = (1024, 1040)  # smallest sensor that pylon's emulator accepts, (width, height) in px
LINE = "Line1"  # the camera's input to which the trigger cable leads

ImageSource = Callable[[CameraSettings, CollectedLight], Image]
"""Renders the image of a camera with given settings from the light that its shutter collected."""


class BenchPylon(EmulatedPylon):
    """pylon with one camera, which is part of an emulated bench."""

    def __init__(
        self,
        size: tuple[int, int],
        shutter: EmulatedShutter,
        render: ImageSource,
        timing: SensorTiming = STRICT,
        bayer: Bayer | None = None,
    ) -> None:
        sensor = (max(size[0], MIN_SENSOR_SIZE[0]), max(size[1], MIN_SENSOR_SIZE[1]))
        super().__init__(
            sensor,
            lambda settings: self.read_out(settings, shutter.expose_now(settings)),
            timing,
            bayer,
        )
        self.shutter, self._render = shutter, render

    def armed_camera(self) -> BenchCamera | None:
        """Return the camera that waits for a trigger pulse."""
        waiting = [c for c in self._open.values() if isinstance(c, BenchCamera) and c.waits_for_pulse()]
        return waiting[0] if waiting else None

    def has_strobe(self) -> bool:
        """Return whether an output of the camera is active while it exposes."""
        return any(isinstance(c, BenchCamera) and c.has_strobe() for c in self._open.values())

    def read_out(self, settings: CameraSettings, collected: CollectedLight) -> Image:
        picture = self._render(settings, collected)
        image: Image = np.zeros(self.size[::-1], raw_dtype(settings.bits))
        image[: picture.shape[0], : picture.shape[1]] = picture
        return image

    def _camera(self, serial: str, instant: Any) -> BenchCamera:
        return BenchCamera(self, serial, instant)


class BenchCamera(EmulatedCamera):
    """A camera whose exposures are made, in the bench's time, while the host waits for them.

    However long rendering takes, no timeout of the host runs out because of it: in the bench's time a frame
    takes no longer than its exposure.
    """

    _emulator: BenchPylon

    def __init__(self, emulator: BenchPylon, serial: str, instant: Any) -> None:
        super().__init__(emulator, serial, instant)
        self.pulses, self._frame_coming = 0, False

    def StartGrabbing(self, strategy: Any) -> None:
        """Arm the camera as pylon does; earlier pulses and exposures are forgotten."""
        self.pulses, self._frame_coming = 0, False
        self._emulator.shutter.clear(self.instant.MaxNumBuffer.GetValue())
        self.instant.StartGrabbing(strategy)

    def ExecuteSoftwareTrigger(self) -> None:
        """Trigger as pylon does, for an exposure that begins now."""
        super().ExecuteSoftwareTrigger()
        self._frame_coming = not self.unplugged

    def has_strobe(self) -> bool:
        lines = self.instant.LineSelector
        selected, states = lines.GetValue(), []
        for line in lines.GetSettableValues():
            lines.SetValue(line)
            states.append((self.instant.LineMode.GetValue(), self.instant.LineSource.GetValue()))
        lines.SetValue(selected)
        return ("Output", "ExposureActive") in states

    def waits_for_pulse(self) -> bool:
        with suppress(genicam.GenericException):  # it is being closed, or is gone
            mode, source = self._features.read(TRIGGER_MODE), self._features.read(TRIGGER_SOURCE)
            return not self.unplugged and (mode, source) == ("On", LINE) and bool(self.instant.IsGrabbing())
        return False

    def exposure_start_s(self, rise_s: float, fall_s: float) -> float:
        """Return when a trigger pulse opens the shutter, by the edge, inverter and delay that are set."""
        begins_high = self._features.read(TRIGGER_EDGE) == EDGES["rising"]
        edge_s = rise_s if begins_high != bool(self._features.read(LINE_INVERTER)) else fall_s
        return edge_s + float(self._features.read(TRIGGER_DELAY_US) or 0.0) / US_PER_S

    def RetrieveResult(self, timeout_ms: int, handling: Any) -> Any:
        """Retrieve a grab result as pylon does, of an exposure that is made meanwhile."""
        if not self._frame_coming and self.waits_for_pulse():
            self._frame_coming = self._expose(timeout_ms / 1000)
        wait_ms = max(timeout_ms, READY_MS) if self._frame_coming else timeout_ms
        result = self.instant.RetrieveResult(wait_ms, handling)
        if result.IsValid():
            self._frame_coming = False
        return result

    def _expose(self, timeout_s: float) -> bool:
        """Let the bench's time pass until the shutter has closed, and hand the image to pylon."""
        exposed = self._emulator.shutter.wait_next(timeout_s)
        if exposed is None:
            return False
        self.instant.WaitForFrameTriggerReady(READY_MS, pylon.TimeoutHandling_ThrowException)
        settings, collected = exposed
        self._emulator.light.set_image(self._emulator.read_out(settings, collected), settings.bits)
        self.instant.TriggerSoftware.Execute()
        return True
