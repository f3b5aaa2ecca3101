"""pylon's emulated camera as the camera of an emulated bench: exposed in its light and its time."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from pypylon import genicam, pylon

from drivers.basler.features import TRIGGER_DELAY_US, TRIGGER_EDGE, TRIGGER_MODE, TRIGGER_SOURCE, US_PER_S
from drivers.basler.options import EDGES
from drivers.emulators.exposure import CollectedLight, EmulatedShutter
from drivers.emulators.pylon import READY_MS, EmulatedCamera, EmulatedPylon
from fpplab.core.conventions import Image, raw_dtype
from fpplab.devices import CameraSettings

MIN_SENSOR_SIZE = (1024, 1040)
"""What pylon's emulator takes, (width, height)."""
LINE = "Line1"
"""Where the trigger cable ends."""

ImageSource = Callable[[CameraSettings, CollectedLight], Image]
"""What a camera with these settings makes of light."""


class BenchPylon(EmulatedPylon):
    """pylon whose one camera looks at the bench. size: of the pictures; beyond them the sensor is dark."""

    def __init__(self, size: tuple[int, int], shutter: EmulatedShutter, render: ImageSource) -> None:
        sensor = (max(size[0], MIN_SENSOR_SIZE[0]), max(size[1], MIN_SENSOR_SIZE[1]))
        super().__init__(sensor, lambda settings: self.read_out(settings, shutter.expose_now(settings)))
        self.shutter, self._render = shutter, render

    def armed_camera(self) -> BenchCamera | None:
        """The camera, if it waits for a pulse on the line."""
        waiting = [c for c in self._open.values() if isinstance(c, BenchCamera) and c.waits_for_pulse()]
        return waiting[0] if waiting else None

    def read_out(self, settings: CameraSettings, collected: CollectedLight) -> Image:
        """The whole sensor after an exposure [v, u]."""
        picture = self._render(settings, collected)
        image: Image = np.zeros(self.size[::-1], raw_dtype(settings.bits))
        image[: picture.shape[0], : picture.shape[1]] = picture
        return image

    def _camera(self, serial: str, instant: Any) -> BenchCamera:
        return BenchCamera(self, serial, instant)


class BenchCamera(EmulatedCamera):
    """A camera whose exposures are made while the host waits for them, in bench time.

    pulses: on the line since it was armed. However long a picture takes to compute, no host waits too short
    for it: on the bench it takes no longer than its exposure.
    """

    _emulator: BenchPylon

    def __init__(self, emulator: BenchPylon, serial: str, instant: Any) -> None:
        super().__init__(emulator, serial, instant)
        self.pulses, self._frame_coming = 0, False

    def StartGrabbing(self, strategy: Any) -> None:
        """As pylon's."""
        self.pulses, self._frame_coming = 0, False
        self._emulator.shutter.clear()
        self.instant.StartGrabbing(strategy)

    def ExecuteSoftwareTrigger(self) -> None:
        """As pylon's, in the light from now on."""
        super().ExecuteSoftwareTrigger()
        self._frame_coming = not self.unplugged

    def waits_for_pulse(self) -> bool:
        """Whether a pulse on the line fires it."""
        with suppress(genicam.GenericException):  # it is being closed, or is gone
            mode, source = self._features.read(TRIGGER_MODE), self._features.read(TRIGGER_SOURCE)
            return not self.unplugged and (mode, source) == ("On", LINE) and bool(self.instant.IsGrabbing())
        return False

    def exposure_start_s(self, rise_s: float, fall_s: float) -> float:
        """When a pulse with these edges opens the shutter."""
        edge_s = rise_s if self._features.read(TRIGGER_EDGE) == EDGES["rising"] else fall_s
        return edge_s + float(self._features.read(TRIGGER_DELAY_US) or 0.0) / US_PER_S

    def _result(self, timeout_ms: int, handling: Any) -> Any:
        if not self._frame_coming and self.waits_for_pulse():
            self._frame_coming = self._expose(timeout_ms / 1000)
        result = super()._result(max(timeout_ms, READY_MS) if self._frame_coming else timeout_ms, handling)
        if result.IsValid():
            self._frame_coming = False
        return result

    def _expose(self, patience_s: float) -> bool:
        """Let the bench go on until the shutter has closed, and hand over what it let in."""
        exposed = self._emulator.shutter.wait_next(patience_s)
        if exposed is None:
            return False
        self.instant.WaitForFrameTriggerReady(READY_MS, pylon.TimeoutHandling_ThrowException)
        settings, collected = exposed
        self._emulator.light.set_image(self._emulator.read_out(settings, collected), settings.bits)
        self.instant.TriggerSoftware.Execute()
        return True
