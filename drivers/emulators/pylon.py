"""pylon's own camera emulator as the far end of the camera driver: fed with images, triggered, made to fail.

The camera is pylon's (`PYLON_CAMEMU`), in this process, behind the same `InstantCamera` as a real one. Added
is what a laboratory adds: light that depends on the camera's settings, a trigger signal on Line1, another
program that has opened the camera, an unplugged cable, and lost frames. Serial numbers are 0815-0000,
0815-0001, …

The emulator reads an image file at the end of each exposure. Its folder has two names of one file, which is
always replaced as a whole. What the emulator cannot do, and its behaviour that no camera documents, is
`PylonPolicy`.
"""

from __future__ import annotations

import math
import os
import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from pypylon import genicam, pylon

from drivers.basler.transport import Pylon
from drivers.clock import ROUNDING_S
from drivers.emulators.exposure import STRICT, SensorTiming
from drivers.genicam.features import Features
from drivers.genicam.names import EXPOSURE_US, GAIN_DB, PIXEL_FORMAT, TRIGGER_MODE, TRIGGER_SOURCE, US_PER_S
from fpplab.core.conventions import Image, raw_dtype
from fpplab.devices import CameraSettings
from fpplab.patterns.mosaic import Bayer

CAMERA_COUNT_VARIABLE = "PYLON_CAMEMU"
"""Environment variable with the number of cameras that pylon emulates; read at every enumeration."""
READY_MS = 5000  # longest time in ms that pylon's emulator is given to become ready for a trigger (chosen)

SceneSource = Callable[[CameraSettings], Image]
"""Renders the whole sensor [v, u] under given settings, in raw integers of `settings.bits`."""


@dataclass(frozen=True)
class PylonPolicy:
    """Behaviour of the emulated camera that is chosen, not documented."""

    exclusive: bool = True  # A camera that is open cannot be opened again, as is reported of real ones
    pulse_waits: bool = True  # A trigger pulse waits for pylon's emulator
    timing: SensorTiming = STRICT  # when the camera is ready for a pulse whose time is given
    exposure_s: float = 100e-6  # time in s that an emulated exposure takes, whatever the camera is set to


class EmulatedPylon(Pylon):
    """Stands in for pylon, as `pylon` of a rig's bench: emulated cameras only, from `start` to `close`."""

    def __init__(
        self,
        size: tuple[int, int] = (1024, 1040),
        scene: SceneSource | None = None,
        policy: PylonPolicy = PylonPolicy(),
        cameras: int = 1,
        bayer: Bayer | None = None,
    ) -> None:
        self.size, self.scene, self.policy, self._cameras = size, scene, policy, cameras
        self.bayer = bayer
        self._open: dict[str, EmulatedCamera] = {}
        self._is_plugged = True

    def start(self) -> None:
        """Switch pylon's emulation on and plug the cameras in."""
        self._before = os.environ.get(CAMERA_COUNT_VARIABLE)
        os.environ[CAMERA_COUNT_VARIABLE] = str(self._cameras)
        self._folder = tempfile.TemporaryDirectory(prefix="fpplab-pylon-", ignore_cleanup_errors=True)
        self.light = EmulatedSensorImage(Path(self._folder.name))
        self.plug_in()

    def close(self) -> None:
        self._folder.cleanup()
        if self._before is None:
            os.environ.pop(CAMERA_COUNT_VARIABLE, None)
        else:
            os.environ[CAMERA_COUNT_VARIABLE] = self._before

    def attach(self, info: Any) -> EmulatedCamera:
        serial = info.GetSerialNumber()
        if not self._is_plugged:
            raise genicam.RuntimeException(
                "The transport layer for device class 'BaslerCamEmu' could not be created. : "
                "RuntimeException thrown"
            )
        if self.policy.exclusive and serial in self._open:
            raise genicam.RuntimeException(
                f"Failed to open device '{serial}' for XML file download. "
                "Error: 'Device is exclusively opened by another client.' : RuntimeException thrown"
            )
        return self._camera(serial, super().attach(info))

    def pulse(self, times: int = 1, rise_s: float | None = None) -> None:
        """Send trigger pulses to Line1 of the camera that was opened last; any thread may call it."""
        for _ in range(times):
            for camera in list(self._open.values())[-1:]:
                camera.pulse(rise_s)

    def unplug(self, noticed: bool = True) -> None:
        """Unplug the cable; the list of pylon's own emulation keeps the camera."""
        # Without it there, pylon 26.9 would free neither the 14 pipes nor the thread of a camera that is
        # destroyed, not even of one that was closed before.
        self._is_plugged = False
        for camera in self._open.values():
            camera.unplugged = True
            if noticed:
                camera.instant.FirePnPCallback.Execute()

    def plug_in(self) -> None:
        """Plug the cable in; the camera has to be opened again."""
        self._is_plugged = True

    def cameras(self) -> dict[str, Any]:
        return super().cameras() if self._is_plugged else {}

    def _layer(self) -> Any:
        return pylon.TlFactory.GetInstance().CreateTl("BaslerCamEmu")

    def _camera(self, serial: str, instant: Any) -> EmulatedCamera:
        """Make the camera, of another class where a subclass wants it."""
        return EmulatedCamera(self, serial, instant)

    def on_opened(self, camera: EmulatedCamera) -> None:
        """Configure pylon's emulator for this sensor; called by a camera that was opened."""
        self._open[camera.serial] = camera
        instant = camera.instant
        instant.WidthMax.SetValue(self.size[0])
        instant.HeightMax.SetValue(self.size[1])
        instant.ExposureTimeAbs.SetValue(self.policy.exposure_s * US_PER_S)
        if self.scene is not None:
            self.light.set_image(np.zeros(self.size[::-1], np.uint8), 8)
            instant.TestImageSelector.SetValue("Off")
            instant.ImageFilename.SetValue(str(self.light.folder))
            instant.ImageFileMode.SetValue("On")

    def on_closed(self, camera: EmulatedCamera) -> None:
        """Let other programs open a camera; called by the camera when it is closed."""
        self._open.pop(camera.serial, None)

    def has_open(self, camera: EmulatedCamera) -> bool:
        return self._open.get(camera.serial) is camera

    def expose(self, camera: EmulatedCamera) -> None:
        """Put what the scene shows at this moment on the sensor."""
        if self.scene is not None:
            self.light.set_image(self.scene(camera.settings()), camera.settings().bits)


class EmulatedCamera:
    """An `InstantCamera` at the end of an emulated cable; all other attributes are those of pylon's."""

    def __init__(self, emulator: EmulatedPylon, serial: str, instant: Any) -> None:
        self.serial, self.instant = serial, instant
        self.frames_to_lose, self.unplugged = 0, False
        self._emulator, self._ready_s = emulator, -math.inf

    def __getattr__(self, name: str) -> Any:
        return getattr(self.instant, name)

    def Open(self) -> None:
        """Open the camera as pylon does, then give it this sensor."""
        self.instant.Open()
        self._features = Features(self.serial, self.instant)
        self._emulator.on_opened(self)

    def Close(self) -> None:
        self._emulator.on_closed(self)
        self.instant.Close()

    def DestroyDevice(self) -> None:
        self._emulator.on_closed(self)
        self.instant.DestroyDevice()

    def GetNodeMap(self) -> Any:
        """Return pylon's node map, with the resulting frame rate that a camera of this timing has."""
        rate, timing = self.instant.AcquisitionFrameRateAbs, self._emulator.policy.timing
        exposure_s = self.instant.GetNodeMap().GetNode(EXPOSURE_US[0]).GetValue() / US_PER_S
        if rate.IsWritable() and rate.GetValue() != timing.reported_rate_hz(exposure_s):
            rate.SetValue(timing.reported_rate_hz(exposure_s))
        return _NodeMap(self.instant.GetNodeMap(), self._emulator.bayer)

    def StartGrabbing(self, strategy: Any) -> None:
        """Arm the camera as pylon does; it is ready then."""
        self._ready_s = -math.inf
        self.instant.StartGrabbing(strategy)

    def ExecuteSoftwareTrigger(self) -> None:
        """Trigger as pylon does, in the light of this moment; without effect on an unplugged camera."""
        if not self.unplugged:
            self._emulator.expose(self)
            self.instant.ExecuteSoftwareTrigger()

    def RetrieveResult(self, timeout_ms: int, handling: Any) -> Any:
        """Retrieve a grab result as pylon does, except for the frames that are to be lost."""
        result = self._result(timeout_ms, handling)
        while self.frames_to_lose and result.IsValid():
            self.frames_to_lose -= 1
            result = self._result(timeout_ms, handling)
        return result

    def _result(self, timeout_ms: int, handling: Any) -> Any:
        return self.instant.RetrieveResult(timeout_ms, handling)

    def pulse(self, rise_s: float | None = None) -> None:
        """Take a pulse on Line1: one frame, if the camera waits for it; without effect during closing."""
        try:
            if rise_s is None or rise_s >= self._ready_s - ROUNDING_S:
                self._expose_on_pulse(rise_s)
        except genicam.GenericException:
            if self._emulator.has_open(self):
                raise

    def _expose_on_pulse(self, rise_s: float | None) -> None:
        armed = self._features.read(TRIGGER_MODE) == "On" and self._features.read(TRIGGER_SOURCE) == "Line1"
        if self.unplugged or not armed or not self.instant.IsGrabbing():
            return
        wait_ms = READY_MS if self._emulator.policy.pulse_waits else 0
        if self.instant.WaitForFrameTriggerReady(wait_ms, pylon.TimeoutHandling_Return):
            if rise_s is not None:
                self._ready_s = rise_s + self._emulator.policy.timing.period_s(self.settings().exposure_s)
            self._emulator.expose(self)
            self.instant.TriggerSoftware.Execute()  # which pylon's emulator obeys with any trigger source

    def settings(self) -> CameraSettings:
        bits = int(re.sub(r"\D", "", self._features.read(PIXEL_FORMAT)))
        return CameraSettings(self._features.read(EXPOSURE_US) / US_PER_S, self._features.read(GAIN_DB), bits)

    def fail_frames(self, frames: int) -> None:
        """Let the next frames arrive incomplete."""
        self.instant.ForceFailedBufferCount.SetValue(frames)
        self.instant.ForceFailedBuffer.Execute()

    def fail_grabbing(self, message: str) -> None:
        """Let pylon's grab engine fail."""
        self.instant.GetStreamGrabberNodeMap().GetNode("ImposedError").SetValue(message)

    def set_exposure_duration(self, exposure_s: float) -> None:
        self.instant.ExposureTimeAbs.SetValue(exposure_s * US_PER_S)


class _Delegate:
    def __init__(self, real: Any) -> None:
        self._real = real

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real, name)


class _NodeMap(_Delegate):
    """pylon's node map, with the pixel formats of one sensor: its emulator has those of all."""

    def __init__(self, real: Any, bayer: Bayer | None) -> None:
        super().__init__(real)
        self._bayer = bayer

    def GetNode(self, name: str) -> Any:
        node = self._real.GetNode(name)
        return _PixelFormat(node, self._bayer) if name == PIXEL_FORMAT[0] else node


class _PixelFormat(_Delegate):
    def __init__(self, real: Any, bayer: Bayer | None) -> None:
        super().__init__(real)
        self._bayer = bayer

    def GetSettableValues(self) -> tuple[str, ...]:
        """List the raw formats, and those that a colour camera makes of several pixels."""
        raw = f"Bayer{self._bayer[:2]}" if self._bayer else "Mono"
        names = self._real.GetSettableValues()
        return tuple(n for n in names if n.startswith((raw, "Mono8", *(("RGB8",) if self._bayer else ()))))


class EmulatedSensorImage:
    """The image on the sensor, as the file that the emulator reads at the end of an exposure."""

    def __init__(self, image_folder: Path) -> None:
        self._image_folder = image_folder
        self.folder = image_folder / "light"
        self.folder.mkdir()

    def set_image(self, image: Image, bits: int) -> None:
        scaled = image if bits == 8 else np.left_shift(image.astype(raw_dtype(16)), 16 - bits)
        self._replace(lambda path: tifffile.imwrite(path, scaled, photometric="minisblack", metadata=None))

    def write_invalid_image(self) -> None:
        self._replace(lambda path: path.write_bytes(b"no picture"))

    def _replace(self, write: Callable[[Path], object]) -> None:
        draft = self._image_folder / "draft"
        write(draft)
        for name in ("a.tif", "b.tif"):  # of a single name the emulator would read the file once
            os.link(draft, self._image_folder / name)  # a symbolic one is for administrators of Windows
            os.replace(self._image_folder / name, self.folder / name)
        draft.unlink()
