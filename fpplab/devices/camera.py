"""The camera, its settings and its frames."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Literal, final

from fpplab.core.conventions import Image, raw_dtype
from fpplab.core.errors import CapabilityError, FrameLossError, SettingError, StateError
from fpplab.devices.device import Device, State

Trigger = Literal["software", "hardware"]


ROUNDING, ROUNDING_DB = 0.1, 0.5
"""How far a device's own grid may take an exposure (as a share) and a gain from what was asked for."""


@dataclass(frozen=True)
class CameraSettings:
    """What a camera can be told. `bits` is the depth of the integers in a frame."""

    exposure_s: float
    gain_db: float = 0.0
    bits: int = 8


@dataclass(frozen=True)
class CameraCaps:
    """What a camera can do. size: (width, height) in px; ranges are (least, most).

    readout_s: from the first row to the last, where they are exposed one after another (rolling shutter):
    what a frame sees must stand still for the exposure and this. dark_s: the same, where rows begin together
    and only end one after another (global reset): no light may fall for so long after the exposure, or the
    later rows have more of it. Both are 0 where all rows are exposed at once.
    """

    size: tuple[int, int]
    bits: tuple[int, ...]
    exposure_s: tuple[float, float]
    gain_db: tuple[float, float]
    triggers: tuple[Trigger, ...]
    readout_s: float = 0.0
    dark_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure: the sensor's raw integers, and where they come from.

    image: uint8 or uint16 [v, u], its owner's alone: no later frame changes it. index: the frame's
    number since `arm`, from 0, as the device counts, so that a gap is a lost frame; acquisition
    makes it the plan's. pattern_id: what was on show, when the backend knows; acquisition fills it
    in otherwise. device_time_s is None where the device has no clock.
    """

    image: Image
    index: int
    settings: CameraSettings
    host_time_s: float
    device_time_s: float | None = None
    pattern_id: str | None = None

    def showing(self, pattern_id: str, index: int) -> Frame:
        """The same frame, named as the picture of one pattern."""
        return replace(self, pattern_id=pattern_id, index=index)


class Camera(Device):
    """A camera: configure, then `snap`, or `arm` and `read`."""

    kind = "camera"
    _settings: CameraSettings | None = None
    _awaited = 0
    _taken = 0

    def _forget(self) -> None:
        self._settings = None

    @property
    @final
    def caps(self) -> CameraCaps:
        """What it can do; known once open."""
        self._need(State.IDLE, State.ARMED, doing="caps")
        with self._guard("caps"):
            return self._caps()

    @final
    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings and return what the device READ BACK.

        Raises `SettingError` for a value the device does not accept: it never clamps.
        """
        self._need(State.IDLE, doing="configure")
        caps = self.caps
        self._within("exposure_s", settings.exposure_s, caps.exposure_s, "s")
        self._within("gain_db", settings.gain_db, caps.gain_db, "dB")
        if settings.bits not in caps.bits:
            raise SettingError(
                self.name, "configure", f"bits is {settings.bits}", f"one of {list(caps.bits)}"
            )
        with self._guard("configure"):
            back = self._configure(settings)
        if not _honoured(settings, back):
            self._settings = None  # what it does now is what nobody asked for
            raise SettingError(
                self.name,
                "configure",
                f"{settings} was asked for, but the device reads {back}",
                "choose what it has",
            )
        self._settings = back
        return back

    @final
    def arm(self, n: int, trigger: Trigger = "software") -> None:
        """Get ready for `n` frames. Raises `CapabilityError` for a trigger it has not."""
        self._need(State.IDLE, doing="arm")
        self._configured("arm")
        if n < 1:
            raise SettingError(self.name, "arm", f"n is {n}", "at least 1")
        if trigger not in self.caps.triggers:
            raise CapabilityError(self.name, "arm", f"has no {trigger} trigger")
        with self._guard("arm"):
            self._arm(n, trigger)
        self._awaited, self._taken = n, 0
        self._state = State.ARMED

    @final
    def read(self, timeout_s: float) -> Frame:
        """The next frame; the last one leaves the camera IDLE.

        Raises `DeviceTimeoutError`, `FrameLossError` (missing, or of another size or depth).
        """
        self._need(State.ARMED, doing="read")
        with self._guard("read"):
            frame = self._read(timeout_s)
            self._checked(frame)
        self._taken += 1
        if self._taken == self._awaited:
            self.stop()
        return frame

    @final
    def stop(self) -> None:
        """Give up waiting; legal whenever the camera is open."""
        self._need(State.IDLE, State.ARMED, doing="stop")
        with self._guard("stop"):
            self._stop()
        self._state = State.IDLE

    @final
    def snap(self, timeout_s: float = 10.0) -> Frame:
        """One frame by software trigger."""
        self.arm(1, "software")
        return self.read(timeout_s)

    def _within(self, what: str, value: float, allowed: tuple[float, float], unit: str) -> None:
        if not allowed[0] <= value <= allowed[1]:
            raise SettingError(
                self.name,
                "configure",
                f"{what} is {value:g} {unit}",
                f"the device accepts {allowed[0]:g} to {allowed[1]:g} {unit}",
            )

    def _configured(self, doing: str) -> CameraSettings:
        if self._settings is None:
            raise StateError(self.name, doing, "is not configured", "configure it first")
        return self._settings

    def _checked(self, frame: Frame) -> None:
        if frame.index != self._taken:
            raise FrameLossError(
                self.name,
                "read",
                f"frame {frame.index} arrived instead of frame {self._taken}",
                "see to the link to the camera, and take the frames again",
            )
        settings = self._configured("read")
        width, height = self.caps.size
        expected = raw_dtype(settings.bits)
        if frame.image.shape != (height, width) or frame.image.dtype != expected:
            raise FrameLossError(
                self.name,
                "read",
                f"frame {frame.index} is {frame.image.dtype} {frame.image.shape[::-1]}",
                f"{expected} {(width, height)} was configured",
            )

    @abstractmethod
    def _caps(self) -> CameraCaps: ...

    @abstractmethod
    def _configure(self, settings: CameraSettings) -> CameraSettings: ...

    @abstractmethod
    def _arm(self, n: int, trigger: Trigger) -> None: ...

    @abstractmethod
    def _read(self, timeout_s: float) -> Frame: ...

    @abstractmethod
    def _stop(self) -> None: ...


def _honoured(asked: CameraSettings, back: CameraSettings) -> bool:
    """Whether a device did what it was asked, but for rounding to its grid."""
    near = abs(back.exposure_s - asked.exposure_s) <= ROUNDING * asked.exposure_s
    return near and abs(back.gain_db - asked.gain_db) <= ROUNDING_DB and back.bits == asked.bits
