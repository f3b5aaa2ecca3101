"""pylon's own camera emulator as the far end of the camera driver: fed with images.

The camera is pylon's (`PYLON_CAMEMU`), in this process, behind the same `InstantCamera` as a real one. Added
is what a laboratory adds: light that depends on the camera's settings, another program that has opened the
camera, and an unplugged cable. Serial numbers are 0815-0000, 0815-0001, …

The emulator reads an image file at the end of each exposure. Its folder has two names of one file, which is
always replaced as a whole.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from pypylon import genicam, pylon

from drivers.basler.transport import Pylon
from drivers.emulators.exposure import STRICT, SensorTiming
from drivers.genicam.features import Features
from drivers.genicam.names import EXPOSURE_US, GAIN_DB, PIXEL_FORMAT, US_PER_S
from fpplab.core.conventions import Image, raw_dtype
from fpplab.devices import CameraSettings
from fpplab.patterns.mosaic import Bayer

CAMERA_COUNT_VARIABLE = "PYLON_CAMEMU"
"""Environment variable with the number of cameras that pylon emulates; read at every enumeration."""
READY_MS = 5000  # longest time in ms that pylon's emulator is given to become ready for a trigger (chosen)

SceneSource = Callable[[CameraSettings], Image]
"""Renders the whole sensor [v, u] under given settings, in raw integers of `settings.bits`."""


class EmulatedPylon(Pylon):
    """Stands in for pylon, as `pylon` of a rig's bench: emulated cameras only, from `start` to `close`."""

    exposure_s = 100e-6
    """Time in s that an emulated exposure takes, whatever the camera is set to (chosen)."""

    def __init__(
        self,
        size: tuple[int, int] = (1024, 1040),
        scene: SceneSource | None = None,
        timing: SensorTiming = STRICT,
        bayer: Bayer | None = None,
    ) -> None:
        self.size, self.scene, self.timing, self.bayer = size, scene, timing, bayer
        self.count = 1  # of the cameras
        self._open: dict[str, EmulatedCamera] = {}
        self._is_plugged = True

    def start(self) -> None:
        """Switch pylon's emulation on and plug the cameras in."""
        self._before = os.environ.get(CAMERA_COUNT_VARIABLE)
        os.environ[CAMERA_COUNT_VARIABLE] = str(self.count)
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
        if serial in self._open:
            raise genicam.RuntimeException(
                f"Failed to open device '{serial}' for XML file download. "
                "Error: 'Device is exclusively opened by another client.' : RuntimeException thrown"
            )
        return self._camera(serial, super().attach(info))

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
        instant.ExposureTimeAbs.SetValue(self.exposure_s * US_PER_S)
        if self.scene is not None:
            self.light.set_image(np.zeros(self.size[::-1], np.uint8), 8)
            instant.TestImageSelector.SetValue("Off")
            instant.ImageFilename.SetValue(str(self.light.folder))
            instant.ImageFileMode.SetValue("On")

    def on_closed(self, camera: EmulatedCamera) -> None:
        """Let other programs open a camera; called by the camera when it is closed."""
        self._open.pop(camera.serial, None)

    def expose(self, camera: EmulatedCamera) -> None:
        """Put what the scene shows at this moment on the sensor."""
        if self.scene is not None:
            self.light.set_image(self.scene(camera.settings()), camera.settings().bits)


class EmulatedCamera:
    """An `InstantCamera` at the end of an emulated cable; all other attributes are those of pylon's."""

    def __init__(self, emulator: EmulatedPylon, serial: str, instant: Any) -> None:
        self.serial, self.instant = serial, instant
        self._emulator, self.unplugged = emulator, False

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
        rate, timing = self.instant.AcquisitionFrameRateAbs, self._emulator.timing
        exposure_s = self.instant.GetNodeMap().GetNode(EXPOSURE_US[0]).GetValue() / US_PER_S
        if rate.IsWritable() and rate.GetValue() != timing.reported_rate_hz(exposure_s):
            rate.SetValue(timing.reported_rate_hz(exposure_s))
        return _NodeMap(self.instant.GetNodeMap(), self._emulator.bayer)

    def ExecuteSoftwareTrigger(self) -> None:
        """Trigger as pylon does, in the light of this moment; without effect on an unplugged camera."""
        if not self.unplugged:
            self._emulator.expose(self)
            self.instant.ExecuteSoftwareTrigger()

    def settings(self) -> CameraSettings:
        bits = int(re.sub(r"\D", "", self._features.read(PIXEL_FORMAT)))
        return CameraSettings(self._features.read(EXPOSURE_US) / US_PER_S, self._features.read(GAIN_DB), bits)


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
        self.replace(lambda path: tifffile.imwrite(path, scaled, photometric="minisblack", metadata=None))

    def replace(self, write: Callable[[Path], object]) -> None:
        draft = self._image_folder / "draft"
        write(draft)
        for name in ("a.tif", "b.tif"):  # of a single name the emulator would read the file once
            os.link(draft, self._image_folder / name)  # a symbolic one is for administrators of Windows
            os.replace(self._image_folder / name, self.folder / name)
        draft.unlink()
