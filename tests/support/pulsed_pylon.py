"""pylon's emulated cameras with a trigger signal on Line1, lost frames, and other faults to provoke."""

from __future__ import annotations

import math
from typing import Any

from pypylon import genicam, pylon

from drivers.clock import ROUNDING_S
from drivers.emulators.pylon import READY_MS, EmulatedCamera, EmulatedPylon, SceneSource
from drivers.genicam.names import TRIGGER_MODE, TRIGGER_SOURCE, US_PER_S
from fpplab.patterns.mosaic import Bayer


class PulsedPylon(EmulatedPylon):
    """Emulated cameras, of which the one that was opened last is triggered."""

    def __init__(
        self,
        size: tuple[int, int] = (1024, 1040),
        scene: SceneSource | None = None,
        cameras: int = 1,
        bayer: Bayer | None = None,
        pulse_waits: bool = True,
    ) -> None:
        super().__init__(size, scene, bayer=bayer)
        self.count, self.pulse_waits = cameras, pulse_waits

    def pulse(self, times: int = 1, rise_s: float | None = None) -> None:
        """Send trigger pulses; any thread may call it."""
        for _ in range(times):
            for camera in list(self._open.values())[-1:]:
                assert isinstance(camera, PulsedCamera)
                camera.pulse(rise_s)

    def show_no_picture(self) -> None:
        """Put a file on the sensor that is no picture."""
        self.light.replace(lambda path: path.write_bytes(b"no picture"))

    def _camera(self, serial: str, instant: Any) -> PulsedCamera:
        return PulsedCamera(self, serial, instant)


class PulsedCamera(EmulatedCamera):
    """A camera that pulses trigger, and that can be made to fail."""

    _emulator: PulsedPylon

    def __init__(self, emulator: PulsedPylon, serial: str, instant: Any) -> None:
        super().__init__(emulator, serial, instant)
        self.frames_to_lose, self._ready_s = 0, -math.inf

    def StartGrabbing(self, strategy: Any) -> None:
        """Arm the camera as pylon does; it is ready then."""
        self._ready_s = -math.inf
        self.instant.StartGrabbing(strategy)

    def RetrieveResult(self, timeout_ms: int, handling: Any) -> Any:
        """Retrieve a grab result as pylon does, except for the frames that are to be lost."""
        result = self.instant.RetrieveResult(timeout_ms, handling)
        while self.frames_to_lose and result.IsValid():
            self.frames_to_lose -= 1
            result = self.instant.RetrieveResult(timeout_ms, handling)
        return result

    def pulse(self, rise_s: float | None = None) -> None:
        """Take a pulse: one frame, if the camera waits for it; without effect during closing."""
        try:
            if rise_s is None or rise_s >= self._ready_s - ROUNDING_S:
                self._expose_on_pulse(rise_s)
        except genicam.GenericException:
            if self._emulator._open.get(self.serial) is self:
                raise

    def _expose_on_pulse(self, rise_s: float | None) -> None:
        armed = self._features.read(TRIGGER_MODE) == "On" and self._features.read(TRIGGER_SOURCE) == "Line1"
        if self.unplugged or not armed or not self.instant.IsGrabbing():
            return
        wait_ms = READY_MS if self._emulator.pulse_waits else 0
        if self.instant.WaitForFrameTriggerReady(wait_ms, pylon.TimeoutHandling_Return):
            if rise_s is not None:
                self._ready_s = rise_s + self._emulator.timing.period_s(self.settings().exposure_s)
            self._emulator.expose(self)
            self.instant.TriggerSoftware.Execute()  # which pylon's emulator obeys with any trigger source

    def fail_frames(self, frames: int) -> None:
        """Let the next frames arrive incomplete."""
        self.instant.ForceFailedBufferCount.SetValue(frames)
        self.instant.ForceFailedBuffer.Execute()

    def fail_grabbing(self, message: str) -> None:
        """Let pylon's grab engine fail."""
        self.instant.GetStreamGrabberNodeMap().GetNode("ImposedError").SetValue(message)

    def set_exposure_duration(self, exposure_s: float) -> None:
        self.instant.ExposureTimeAbs.SetValue(exposure_s * US_PER_S)
