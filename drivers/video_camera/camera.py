"""A video camera behind the interface of `fpplab.devices`.

A camera is refused where its frames would not be the sensor's own integers, or where it chooses the exposure
itself.
"""

import errno
import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from drivers.genicam.gain import to_db, to_raw
from drivers.genicam.options import RawGain
from drivers.video_camera.device import Control, StampedFrame, VideoDevice
from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Image, raw_dtype
from fpplab.core.errors import (
    CapabilityError,
    DeviceError,
    DisconnectedError,
    FrameLossError,
    SettingError,
    StateError,
)
from fpplab.devices import CameraCaps, CameraSettings, DeviceInfo, FreeFrame, FreeRun, FreeRunningCamera

PositiveCount = Annotated[int, Field(ge=1)]


class VideoOptions(Document):
    """The camera's section in a rig file."""

    device: str
    """Device file; a link of /dev/v4l/by-id does not change when other cameras are plugged in."""
    size: tuple[PositiveCount, PositiveCount] | None = None
    """Width and height of frames in px; by default as the camera is set."""
    shutter: Literal["rolling", "global"] = "rolling"
    """The shutter that the camera has; the device does not report it."""
    raw_gain: RawGain | None = None
    """What the numbers of its gain mean; without it only the least gain is used, which counts as 0 dB."""
    latency_s: Annotated[float, Field(ge=0)] = 0.0
    """Longest time in s for which the camera holds a frame back before it is stamped."""


EXPOSURE_MODE, EXPOSURE_100_US, GAIN = 0x009A_0901, 0x009A_0902, 0x0098_0913
MANUAL = 1  # value of `EXPOSURE_MODE` (V4L2_EXPOSURE_MANUAL)

RAW: dict[int, int | None] = {
    EXPOSURE_MODE: MANUAL,
    0x009A_0903: 0,  # frame rate that depends on the exposure
    0x0098_0912: 0,  # automatic gain
    0x0098_0920: 0,  # automatic brightness
    0x0098_0900: None,  # brightness
    0x0098_0901: None,  # contrast
    0x0098_0910: 100,  # gamma, in hundredths
    0x0098_0914: 0,  # mirrored
    0x0098_0915: 0,  # upside down
    0x0098_091B: 0,  # sharpness
    0x0098_091C: 0,  # backlight compensation
    0x009A_0915: 0,  # wide dynamic range
    0x009F_0903: 0,  # test pattern
}
"""Values by control; None is the control's default, where no value is laid down as neutral.

A camera may lack any of them; those that it has must have these values.
"""


UNIT_S = 1e-4  # unit of V4L2_CID_EXPOSURE_ABSOLUTE in s (the kernel's documentation)
FORMATS = {"GREY": 8, "Y10 ": 10, "Y12 ": 12, "Y14 ": 14, "Y16 ": 16}
"""Bit depth of each pixel format whose values are right-justified integers."""


class VideoCamera(FreeRunningCamera):
    """A camera by its device file; an emulated bench may be the kernel by its attribute `video`."""

    _device: Any = None

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        self._options = config.validate(options, VideoOptions, self.name)
        self._connect = getattr(bench, "video", None) or VideoDevice

    def _open(self) -> None:
        try:
            self._device = self._connect(self._options.device)
        except FileNotFoundError as error:
            raise self._disconnected("open") from error
        self._card, self._bus, captures = self._device.identity()
        if not captures:
            raise CapabilityError(
                self.name, "open", f"{self._options.device} delivers no frames", "name another /dev/video…"
            )
        self._bits = {FORMATS[letters]: letters for letters in self._device.formats() if letters in FORMATS}
        if not self._bits:
            raise CapabilityError(
                self.name,
                "open",
                f"{self._card} has only {', '.join(self._device.formats()) or 'no format'}: its frames are "
                "converted or compressed, not the sensor's integers",
                f"use a camera that delivers {', '.join(letters.strip() for letters in FORMATS)}",
            )
        self._make_raw()
        self._exposure, self._gain = self._own_exposure(), self._device.control(GAIN)
        self._set_format(next(iter(self._bits.values())))
        self._present_caps = self._read_caps()

    def _close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def _info(self) -> DeviceInfo:
        return DeviceInfo("camera", self._card, self._options.device, f"video, {self._bus}")

    def _caps(self) -> CameraCaps:
        return self._present_caps

    def _configure(self, settings: CameraSettings) -> CameraSettings:
        self._forget()  # settings that are refused may have been applied in part
        self._set_format(self._bits[settings.bits])
        units = round(settings.exposure_s / UNIT_S)
        exposure_s = self._set_control(EXPOSURE_100_US, units, self._exposure) * UNIT_S
        gain_db = self._set_gain(settings.gain_db)
        self._present_caps = self._read_caps()
        return CameraSettings(exposure_s, gain_db, settings.bits)

    def _run(self) -> FreeRun:
        return FreeRun(self._period_s, self._options.latency_s)

    def _start(self) -> None:
        self._device.start()

    def _next(self, timeout_s: float) -> FreeFrame | None:
        frame = self._device.read(timeout_s)
        if frame is None:
            return None
        # The kernel stamps by one clock or another: frames without the right one are refused, not counted.
        return FreeFrame(lambda: self._image(frame), math.inf if frame.time_s is None else frame.time_s)

    def _image(self, frame: StampedFrame) -> Image:
        _, width, height, pitch = self._device.format()
        dtype = np.dtype(raw_dtype(self._configured("read").bits))
        if frame.is_damaged or frame.pixels.size < height * pitch or pitch < width * dtype.itemsize:
            raise FrameLossError(
                self.name,
                "read",
                f"frame {self._taken} is damaged: {frame.pixels.size} of {height * pitch} bytes came",
                "check the cable and the USB controller; take the frames again",
            )
        rows = frame.pixels[: height * pitch].reshape(height, pitch)[:, : width * dtype.itemsize]
        return np.ascontiguousarray(rows).view(dtype)

    def _stop(self) -> None:
        self._device.stop()

    def _fault(self) -> None:
        """Stop the camera at once, so that a late frame is not taken for the next one."""
        super()._fault()
        if self._device is not None:
            with suppress(OSError):  # the original fault is the one to report
                self._device.stop()

    @contextmanager
    def _guard(self, operation: str) -> Iterator[None]:
        """Translate the kernel's errors into the device errors of fpplab."""
        with super()._guard(operation):
            try:
                yield
            except OSError as error:
                if error.errno is None:  # not the kernel's
                    raise
                raise self._described(operation, error) from error

    def _described(self, operation: str, error: OSError) -> DeviceError:
        if error.errno in (errno.ENODEV, errno.ENXIO):
            return self._disconnected(operation)
        if error.errno == errno.EBUSY:
            return StateError(self.name, operation, "another program has the camera open", "close it there")
        if error.errno in (errno.EACCES, errno.EPERM):
            remedy = "add yourself to the group video (sudo usermod -aG video $USER), and log in again"
            return DeviceError(self.name, operation, f"this user may not open {self._options.device}", remedy)
        message = error.strerror or str(error)
        if error.errno == errno.ENOSYS:
            return CapabilityError(
                self.name, operation, message, "use the GenTL producer of the camera's maker"
            )
        return DeviceError(
            self.name, operation, f"the kernel says: {message}", "unplug it and plug it in again"
        )

    def _make_raw(self) -> None:
        for number, raw in RAW.items():
            control = self._device.control(number)
            if control is None:
                continue
            value = control.default if raw is None else raw
            if self._device.get(number) != value:
                self._set_if_possible(number, value, control)
            if (read_back := self._device.get(number)) != value:
                raise SettingError(
                    self.name,
                    "open",
                    f"{control.name} is {read_back} and cannot be set to {value}",
                    "frames would not be the sensor's own values at a known exposure; use another camera",
                )

    def _own_exposure(self) -> Control:
        control = self._device.control(EXPOSURE_100_US)
        if control is None or not control.is_settable:
            why = "it has no such control" if control is None else "its automatic exposure stays on"
            raise CapabilityError(
                self.name,
                "open",
                f"the exposure of {self._card} cannot be set: {why}",
                "use a camera whose exposure can be set",
            )
        return Control(
            control.name, max(control.minimum, 1), control.maximum, control.step, control.default, True
        )

    def _set_if_possible(self, number: int, value: int, control: Control) -> None:
        if control.is_settable and control.minimum <= value <= control.maximum:
            try:
                self._device.set(number, value)
            except OSError as error:
                if error.errno != errno.EINVAL:  # which means that its menu has no such entry
                    raise

    def _set_control(self, number: int, value: int, control: Control) -> int:
        """Set a control to the nearest of its steps, and read it back."""
        steps = round((value - control.minimum) / max(control.step, 1))
        self._device.set(number, min(control.minimum + steps * max(control.step, 1), control.maximum))
        return int(self._device.get(number))

    def _set_gain(self, gain_db: float) -> float:
        conversion = self._options.raw_gain
        if self._gain is None:
            return 0.0
        if conversion is None:
            self._set_control(GAIN, self._gain.minimum, self._gain)
            return 0.0
        return to_db(self._set_control(GAIN, round(to_raw(gain_db, conversion)), self._gain), conversion)

    def _gain_limits_db(self) -> tuple[float, float]:
        conversion = self._options.raw_gain
        if self._gain is None or conversion is None:
            return 0.0, 0.0
        minimum = self._gain.minimum if conversion.unity is None else max(self._gain.minimum, 1)
        return to_db(minimum, conversion), to_db(self._gain.maximum, conversion)

    def _set_format(self, letters: str) -> None:
        size = self._options.size or self._device.format()[1:3]
        self._device.set_format(letters, *size)
        read_back, width, height, _ = self._device.format()
        if (read_back, width, height) != (letters, *size):
            raise SettingError(
                self.name,
                "configure",
                f"{letters.strip()} of {size[0]} x {size[1]} px was asked for",
                f"the camera has {read_back.strip()} of {width} x {height} px",
            )

    def _read_caps(self) -> CameraCaps:
        _, width, height, _ = self._device.format()
        period_s = self._device.period_s()
        if period_s is None:
            raise CapabilityError(
                self.name, "open", "it does not state its frame rate", "use a camera whose driver states it"
            )
        self._period_s = period_s
        return CameraCaps(
            (width, height),
            tuple(sorted(self._bits)),
            (self._exposure.minimum * UNIT_S, self._exposure.maximum * UNIT_S),
            self._gain_limits_db(),
            ("software",),
            0.0 if self._options.shutter == "global" else period_s,
            exposure_step_s=self._exposure.step * UNIT_S,
        )

    def _disconnected(self, operation: str) -> DisconnectedError:
        return DisconnectedError(
            self.name,
            operation,
            f"there is no camera at {self._options.device}",
            "plug it in and open it again",
        )
