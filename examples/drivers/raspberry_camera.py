"""The camera of a Raspberry Pi, by picamera2: raw frames of a camera that runs freely.

camera: {backend: "raspberry_camera:RaspberryCamera", number: 0, bits: 10}
"""

import math
import time
from typing import Any

import numpy as np
from picamera2 import Picamera2

from fpplab.core.errors import ConfigError
from fpplab.devices import CameraCaps, CameraSettings, DeviceInfo, FreeFrame, FreeRun, FreeRunningCamera

US = 1e-6
LATE_FRAMES = 12
"""So many frames may pass until a change of settings shows."""


class RaspberryCamera(FreeRunningCamera):
    """The camera with a number, as `rpicam-hello --list-cameras` counts them."""

    def _setup(self, options: dict[str, Any], shared: Any) -> None:
        self._number = options.pop("number", 0)
        if not isinstance(self._number, int):
            raise ConfigError(f"'{self.name}.number' must be a whole number")
        super()._setup(options, shared)

    def _open(self) -> None:
        self._pi = Picamera2(self._number)
        self._mode = max(self._pi.sensor_modes, key=lambda mode: mode["size"])
        raw = {"format": str(self._mode["unpacked"]), "size": self._mode["size"]}
        self._pi.configure(self._pi.create_video_configuration(raw=raw))
        self._pi.set_controls({"AeEnable": False, "AwbEnable": False, "NoiseReductionMode": 0})
        self._pi.start()
        self._period_s = self._pi.capture_metadata()["FrameDuration"] * US

    def _close(self) -> None:
        if hasattr(self, "_pi"):
            self._pi.stop()
            self._pi.close()

    def _info(self) -> DeviceInfo:
        return DeviceInfo("camera", str(self._pi.camera_properties["Model"]), str(self._number), "CSI")

    def _caps(self) -> CameraCaps:
        least_us, most_us, _ = self._pi.camera_controls["ExposureTime"]
        least, most, _ = self._pi.camera_controls["AnalogueGain"]
        return CameraCaps(
            size=self._mode["size"],
            bits=(self._mode["bit_depth"],),
            exposure_s=(least_us * US, most_us * US),
            gain_db=(20.0 * math.log10(least), 20.0 * math.log10(most)),
            triggers=("software",),
            readout_s=1.0 / self._mode["fps"],
            exposure_step_s=1.0 / self._mode["fps"] / self._mode["size"][1],
        )

    def _configure(self, settings: CameraSettings) -> CameraSettings:
        wanted_us, factor = round(settings.exposure_s / US), 10.0 ** (settings.gain_db / 20.0)
        fastest_us = round(1.0 / self._mode["fps"] / US)
        self._pi.set_controls(
            {
                "ExposureTime": wanted_us,
                "AnalogueGain": factor,
                "FrameDurationLimits": (fastest_us, max(fastest_us, wanted_us)),
            }
        )
        for _ in range(LATE_FRAMES):
            read = self._pi.capture_metadata()
        self._period_s = read["FrameDuration"] * US
        gain_db = 20.0 * math.log10(read["AnalogueGain"])
        return CameraSettings(read["ExposureTime"] * US, gain_db, settings.bits)

    def _run(self) -> FreeRun:
        return FreeRun(period_s=self._period_s)

    def _start(self) -> None:
        """It runs from opening to closing."""

    def _stop(self) -> None:
        """It runs from opening to closing."""

    def _next(self, timeout_s: float) -> FreeFrame | None:
        job = self._pi.capture_request(wait=False)
        try:
            request = self._pi.wait(job, timeout=max(timeout_s, 0.0))
        except TimeoutError:
            return None
        try:
            pixels, read = request.make_array("raw").view(np.uint16), request.get_metadata()
        finally:
            request.release()
        width, height = self._mode["size"]
        began_s = time.monotonic() - (
            time.clock_gettime(time.CLOCK_BOOTTIME) - read["SensorTimestamp"] * 1e-9
        )
        return FreeFrame(pixels[:height, :width].copy(), began_s, read["ExposureTime"] * US)
