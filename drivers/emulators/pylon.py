"""The other end of pylon: its own camera emulator, fed with frames, pulsed, and made to fail.

The camera is pylon's (`PYLON_CAMEMU`), in this process, behind the same `InstantCamera` as a real one. What
is added is what a bench adds: light that depends on the camera's settings, a wire to Line1, another program
that has the camera, a cable that is pulled, frames that are lost on the way. Serial numbers are 0815-0000,
0815-0001, …

The emulator reads a file at the end of each exposure: two names of one file, which is replaced as a whole,
are the light on the sensor now. What it cannot do, and its behaviour that no camera documents, is `PylonPolicy`.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from pypylon import genicam, pylon

from drivers.basler.features import (
    EXPOSURE_US,
    GAIN_DB,
    PIXEL_FORMAT,
    TRIGGER_MODE,
    TRIGGER_SOURCE,
    US_PER_S,
    Features,
)
from drivers.basler.transport import Pylon
from fpplab.core.conventions import Image, raw_dtype
from fpplab.devices import CameraSettings

CAMERA_COUNT_VARIABLE = "PYLON_CAMEMU"
"""How many cameras pylon emulates: read by pylon at every enumeration."""
READY_MS = 5000

SceneSource = Callable[[CameraSettings], Image]
"""What the sensor sees under some settings: raw integers of `settings.bits`, the whole sensor [v, u]."""


@dataclass(frozen=True)
class PylonPolicy:
    """Behaviour of the emulated bench that is chosen, not documented.

    exclusive: a camera that is open cannot be opened again, as reported of real ones; pylon's emulator
        lets it.
    patient: a pulse waits for a camera that is not ready; otherwise it is lost, as on a real wire.
    exposure_s: what an emulated exposure takes, whatever the camera is set to.
    """

    exclusive: bool = True
    pulse_waits: bool = True
    exposure_s: float = 100e-6


class EmulatedPylon(Pylon):
    """pylon with emulated cameras alone, between `start` and `close`.

    size: of the sensor, at least 1024 x 1040; smaller pictures by the camera's ROI. scene: what it sees;
    pylon's moving test image without one. A rig's bench hands it to the driver as its `pylon`.
    """

    def __init__(
        self,
        size: tuple[int, int] = (1024, 1040),
        scene: SceneSource | None = None,
        policy: PylonPolicy = PylonPolicy(),
        cameras: int = 1,
    ) -> None:
        self.size, self.scene, self.policy, self._cameras = size, scene, policy, cameras
        self._open: dict[str, EmulatedCamera] = {}

    def start(self) -> None:
        """Switch the emulation on."""
        self._before = os.environ.get(CAMERA_COUNT_VARIABLE)
        self._folder = tempfile.TemporaryDirectory(prefix="fpplab-pylon-")
        self.light = EmulatedSensorImage(Path(self._folder.name))
        self.plug_in()

    def close(self) -> None:
        """Switch it off and leave nothing behind."""
        self._folder.cleanup()
        if self._before is None:
            os.environ.pop(CAMERA_COUNT_VARIABLE, None)
        else:
            os.environ[CAMERA_COUNT_VARIABLE] = self._before

    def attach(self, info: Any) -> EmulatedCamera:
        """The camera, as `Pylon.attach` has it. Raises what pylon does when another program has it."""
        serial = info.GetSerialNumber()
        if self.policy.exclusive and serial in self._open:
            raise genicam.RuntimeException(
                f"Failed to open device '{serial}' for XML file download. "
                "Error: 'Device is exclusively opened by another client.' : RuntimeException thrown"
            )
        return self._camera(serial, super().attach(info))

    def pulse(self, times: int = 1) -> None:
        """Pulses on Line1 of the camera that was opened last, from whatever thread they come."""
        for _ in range(times):
            for camera in list(self._open.values())[-1:]:
                camera.pulse()

    def unplug(self, noticed: bool = True) -> None:
        """Pull the cable. noticed: whether pylon's notice of it comes through, which is sometimes missed."""
        os.environ[CAMERA_COUNT_VARIABLE] = "0"
        for camera in self._open.values():
            camera.unplugged = True
            if noticed:
                camera.instant.FirePnPCallback.Execute()

    def plug_in(self) -> None:
        """Plug the cable in; the camera has to be opened again."""
        os.environ[CAMERA_COUNT_VARIABLE] = str(self._cameras)

    def cameras(self) -> dict[str, Any]:
        """As `Pylon.cameras` has it, of the emulated ones."""
        return super().cameras() if os.environ[CAMERA_COUNT_VARIABLE] != "0" else {}

    def _layer(self) -> Any:
        return pylon.TlFactory.GetInstance().CreateTl("BaslerCamEmu")

    def _camera(self, serial: str, instant: Any) -> EmulatedCamera:
        return EmulatedCamera(self, serial, instant)

    def on_opened(self, camera: EmulatedCamera) -> None:
        """Set the emulator up as the sensor of this bench."""
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
        """Another program may have it now."""
        self._open.pop(camera.serial, None)

    def has_open(self, camera: EmulatedCamera) -> bool:
        """Whether a program has it."""
        return self._open.get(camera.serial) is camera

    def expose(self, camera: EmulatedCamera) -> None:
        """Let the light of this moment fall on the sensor."""
        if self.scene is not None:
            self.light.set_image(self.scene(camera.settings()), camera.settings().bits)


class EmulatedCamera:
    """An `InstantCamera` at the end of an emulated cable; everything else is pylon's.

    lose: how many of the next frames are lost on the way. pulled: the cable is out.
    """

    def __init__(self, emulator: EmulatedPylon, serial: str, instant: Any) -> None:
        self.serial, self.instant = serial, instant
        self.frames_to_lose, self.unplugged = 0, False
        self._emulator = emulator

    def __getattr__(self, name: str) -> Any:
        return getattr(self.instant, name)

    def Open(self) -> None:
        """As pylon's; the sensor is then this bench's."""
        self.instant.Open()
        self._features = Features(self.serial, self.instant)
        self._emulator.on_opened(self)

    def Close(self) -> None:
        """As pylon's."""
        self._emulator.on_closed(self)
        self.instant.Close()

    def DestroyDevice(self) -> None:
        """As pylon's."""
        self._emulator.on_closed(self)
        self.instant.DestroyDevice()

    def ExecuteSoftwareTrigger(self) -> None:
        """As pylon's, under the light of this moment; it does not reach a camera that is unplugged."""
        if not self.unplugged:
            self._emulator.expose(self)
            self.instant.ExecuteSoftwareTrigger()

    def RetrieveResult(self, timeout_ms: int, handling: Any) -> Any:
        """As pylon's, but for the frames that are to be lost."""
        result = self._result(timeout_ms, handling)
        while self.frames_to_lose and result.IsValid():
            self.frames_to_lose -= 1
            result = self._result(timeout_ms, handling)
        return result

    def _result(self, timeout_ms: int, handling: Any) -> Any:
        return self.instant.RetrieveResult(timeout_ms, handling)

    def pulse(self) -> None:
        """A pulse on Line1: one frame, if the camera waits for it; a camera being closed takes no notice."""
        try:
            self._pulse()
        except genicam.GenericException:
            if self._emulator.has_open(self):
                raise

    def _pulse(self) -> None:
        armed = self._features.read(TRIGGER_MODE) == "On" and self._features.read(TRIGGER_SOURCE) == "Line1"
        if self.unplugged or not armed or not self.instant.IsGrabbing():
            return
        wait_ms = READY_MS if self._emulator.policy.pulse_waits else 0
        if self.instant.WaitForFrameTriggerReady(wait_ms, pylon.TimeoutHandling_Return):
            self._emulator.expose(self)
            self.instant.TriggerSoftware.Execute()

    def settings(self) -> CameraSettings:
        """What the camera is set to."""
        bits = int(self._features.read(PIXEL_FORMAT).removeprefix("Mono"))
        return CameraSettings(self._features.read(EXPOSURE_US) / US_PER_S, self._features.read(GAIN_DB), bits)

    def fail_frames(self, frames: int) -> None:
        """The next so many frames arrive incomplete."""
        self.instant.ForceFailedBufferCount.SetValue(frames)
        self.instant.ForceFailedBuffer.Execute()

    def fail_grabbing(self, words: str) -> None:
        """Pylon's grab engine fails with these words; mended with none."""
        self.instant.GetStreamGrabberNodeMap().GetNode("ImposedError").SetValue(words)

    def set_exposure_duration(self, exposure_s: float) -> None:
        """Let emulated exposures take so long."""
        self.instant.ExposureTimeAbs.SetValue(exposure_s * US_PER_S)


class EmulatedSensorImage:
    """The picture on the sensor, as the file that the emulator reads at the end of an exposure."""

    def __init__(self, place: Path) -> None:
        self._place = place
        self.folder = place / "light"
        self.folder.mkdir()
        for name in ("a.tif", "b.tif"):  # of a single name the emulator would read the file once
            (self.folder / name).symlink_to(place / "now.tif")

    def set_image(self, image: Image, bits: int) -> None:
        """From now on this is what falls on the sensor; the emulator takes the upper `bits` of it."""
        scaled = image if bits == 8 else np.left_shift(image.astype(raw_dtype(16)), 16 - bits)
        self._replace(lambda path: tifffile.imwrite(path, scaled, photometric="minisblack", metadata=None))

    def write_invalid_image(self) -> None:
        """From now on what falls on the sensor is no picture."""
        self._replace(lambda path: path.write_bytes(b"no picture"))

    def _replace(self, write: Callable[[Path], object]) -> None:
        draft = self._place / "draft"
        write(draft)
        os.replace(draft, self._place / "now.tif")
