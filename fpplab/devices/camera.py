"""The camera, its settings and its frames."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Literal, final, get_args

from fpplab.core.conventions import Image, raw_dtype
from fpplab.core.errors import CapabilityError, FrameLossError, SettingError, StateError
from fpplab.devices.device import Device, State
from fpplab.patterns.mosaic import Bayer

Trigger = Literal["software", "hardware"]


@dataclass(frozen=True)
class CameraSettings:
    """Settings of a camera."""

    exposure_s: float
    gain_db: float = 0.0
    bits: int = 8  # depth of the integers in a frame


@dataclass(frozen=True)
class CameraCaps:
    """What a camera can do; ranges are (minimum, maximum)."""

    size: tuple[int, int]  # (width, height) of its frames in px
    bits: tuple[int, ...]  # depths that its frames can have
    exposure_s: tuple[float, float]
    gain_db: tuple[float, float]
    triggers: tuple[Trigger, ...]  # whatever the input is called
    readout_s: float = 0.0
    """From the first row to the last, where they are exposed one after another (rolling shutter): what a
    frame sees must stand still for the exposure and this. 0 where all rows are exposed simultaneously."""
    dark_s: float = 0.0
    """The same, where rows begin together and only end one after another (global reset): no light may fall
    for so long after the exposure, or the later rows have more of it."""
    period_s: float | None = None
    """Shortest time from one hardware trigger to the next at the present settings: a camera ignores one that
    comes earlier. 0 where it is always ready; None where the camera does not report it."""
    offset: tuple[int, int] | None = None
    """Column and row of the sensor where its frames begin, in px, since images of another region have another
    calibration; None where the camera does not report it."""
    bayer: Bayer | None = None
    """Colours of the filter on its pixels, of its frames' first two rows; None where all are alike."""
    strobe: bool = False
    """Whether an output of it is active while it exposes, by which a projector can follow it."""
    exposure_step_s: float = 0.0
    """Step of its exposures, such as the time of a sensor row: the device takes the nearest. 0 where steps
    are finer than a tenth of the exposure."""
    buffers: int | None = None
    """How many frames of hardware triggers it keeps until they are read, at the present settings; `arm` takes
    no more, and longer plans are taken in parts. None where nothing limits them."""

    def __post_init__(self) -> None:
        for name in ("size", "bits", "exposure_s", "gain_db", "triggers"):
            if not isinstance(value := getattr(self, name), tuple):
                raise TypeError(f"CameraCaps.{name} is {value!r}; it must be a tuple; fix the driver")
        if self.exposure_s[0] >= 1.0:  # the shortest exposure of machine vision cameras is 1 µs to 1 ms
            shortest = f"CameraCaps.exposure_s begins at {self.exposure_s[0]:g} s"
            raise ValueError(f"{shortest}; it is in seconds, not in µs; fix the driver")
        triggers = get_args(Trigger)
        if unknown := set(self.triggers) - set(triggers):
            raise ValueError(
                f"CameraCaps.triggers has '{unknown.pop()}'; there are {', '.join(triggers)}; fix the driver"
            )


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure: the sensor's raw integers, and where they come from."""

    image: Image  # raw integers (height, width), not shared: no later frame changes them
    index: int  # number since `arm`, as the device counts, so that a gap is a lost frame; then the plan's
    settings: CameraSettings  # as they were read back
    host_time_s: float  # when it arrived, by `time.time`
    device_time_s: float | None = None  # by the device's clock; None where it has none
    pattern_id: str | None = None  # what was on show, where the backend knows; acquisition fills it in

    def showing(self, pattern_id: str, index: int) -> Frame:
        """Name the frame as the picture of one pattern, the image `index` of its plan."""
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
            return self._of_kind(CameraCaps, self._caps(), "_caps")

    @final
    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings and return what the device READ BACK.

        Parameters
        ----------
        settings : CameraSettings
            The requested settings.

        Returns
        -------
        CameraSettings
            What the device has, which may differ by its own grid of exposures and gains.

        Raises
        ------
        SettingError
            The device does not accept a value: it never clamps.
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
            back = self._of_kind(CameraSettings, self._configure(settings), "_configure")
        if not are_settings_honoured(settings, back, caps):
            self._settings = None  # the device now has settings that were not requested
            raise SettingError(
                self.name,
                "configure",
                f"{settings} was asked for, but the device reads {back}",
                _unit_hint(back.exposure_s / settings.exposure_s) or "choose what it has",
            )
        self._settings = back
        return back

    @final
    def arm(self, n: int, trigger: Trigger = "software") -> None:
        """Get ready for frames; the camera is ARMED afterwards.

        Parameters
        ----------
        n : int
            How many, at least 1.
        trigger : str
            `software`: each `read` exposes. `hardware`: pulses at the trigger input do.

        Raises
        ------
        StateError
            It is not configured.
        SettingError
            n is less than 1.
        CapabilityError
            It has no such trigger, or does not keep so many frames.
        """
        self._need(State.IDLE, doing="arm")
        self._configured("arm")
        if n < 1:
            raise SettingError(self.name, "arm", f"n is {n}", "at least 1")
        if trigger not in self.caps.triggers:
            raise CapabilityError(self.name, "arm", f"has no {trigger} trigger")
        self._check_buffers(n, trigger)
        with self._guard("arm"):
            self._arm(n, trigger)
        self._awaited, self._taken = n, 0
        self._state = State.ARMED

    @final
    def read(self, timeout_s: float) -> Frame:
        """Wait for the next frame; the last one leaves the camera IDLE.

        Parameters
        ----------
        timeout_s : float
            Longest time in s to wait.

        Returns
        -------
        Frame
            The next in order.

        Raises
        ------
        DeviceTimeoutError
            None came in time.
        FrameLossError
            One is missing, or it is of another size or depth than configured.
        """
        self._need(State.ARMED, doing="read")
        with self._guard("read"):
            frame = self._of_kind(Frame, self._read(timeout_s), "_read")
            self._checked(frame)
        self._taken += 1
        if self._taken == self._awaited:
            self.stop()
        return frame

    @final
    def stop(self) -> None:
        """Stop waiting for frames; legal whenever the camera is open."""
        self._need(State.IDLE, State.ARMED, doing="stop")
        with self._guard("stop"):
            self._stop()
        self._state = State.IDLE

    @final
    def snap(self, timeout_s: float = 10.0) -> Frame:
        """Take one frame by software trigger.

        Parameters
        ----------
        timeout_s : float
            Longest time in s to wait.

        Returns
        -------
        Frame
            With the index 0.
        """
        self.arm(1, "software")
        return self.read(timeout_s)

    def _check_buffers(self, n: int, trigger: Trigger) -> None:
        kept = self.caps.buffers
        if trigger == "hardware" and kept is not None and n > kept:
            size = "{} x {}".format(*self.caps.size)
            raise CapabilityError(
                self.name,
                "arm",
                f"{n} triggered frames are to wait until they are read, and it keeps {kept} of {size} px",
                "use fewer bits, a smaller region, fewer images in the plan, or a stepped plan",
            )

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
                "check the link to the camera, and take the frames again",
            )
        settings = self._configured("read")
        width, height = self.caps.size
        expected = raw_dtype(settings.bits)
        if frame.image.shape != (height, width) or frame.image.dtype != expected:
            raise FrameLossError(
                self.name,
                "read",
                f"frame {frame.index} is an array {frame.image.shape} of {frame.image.dtype}",
                f"{(height, width)} of {expected} was configured, rows before columns",
            )
        if settings.bits < 8 * expected.itemsize and frame.image.max() >> settings.bits:
            raise FrameLossError(
                self.name,
                "read",
                f"frame {frame.index} has levels of more than {settings.bits} bits",
                "its pixels are left-justified: the driver must shift them to the right, or use 8 or 16 bits",
            )

    @abstractmethod
    def _caps(self) -> CameraCaps:
        """Tell what this camera can do, as it says itself.

        Called by `caps`, often: in IDLE before every use, and in ARMED for every frame that is checked. It
        must be quick and may only change while the camera is IDLE.

        Returns
        -------
        CameraCaps
            Its capabilities at the present settings: exposures in s, gains in dB, size in px.
        """

    @abstractmethod
    def _configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings that lie within `_caps`, and give what the device then reads back.

        Called by `configure` in IDLE, any number of times. Do not clamp and do not give back what was asked
        for: read the device. The base class refuses what differs by more than the device's grid::

            def _configure(self, settings):
                self._sdk.set("ExposureTime", 1e6 * settings.exposure_s)
                ...
                return CameraSettings(self._sdk.get("ExposureTime") / 1e6, self._sdk.get("Gain"), bits)

        Parameters
        ----------
        settings : CameraSettings
            Exposure in s, gain in dB, depth in bits.

        Returns
        -------
        CameraSettings
            As the device reads back, in the same units.

        Raises
        ------
        SettingError
            The device refuses a combination of values that `_caps` allows one by one.
        """

    @abstractmethod
    def _arm(self, n: int, trigger: Trigger) -> None:
        """Get ready for `n` frames; the count of `Frame.index` begins at 0 again.

        Called by `arm` in IDLE, configured. When it returns, the first hardware pulse must find the camera
        ready. What was left from before must not come as a frame.

        Parameters
        ----------
        n : int
            Number of frames, at least 1.
        trigger : str
            `software` or `hardware`, one of `_caps().triggers`.

        Raises
        ------
        DeviceError
            It cannot get ready.
        """

    @abstractmethod
    def _read(self, timeout_s: float) -> Frame:
        """Deliver the next frame, in the order of exposure.

        Called by `read` in ARMED, `n` times at most. With the software trigger it exposes now, whatever is on
        show; with the hardware trigger it waits for the frame of the next pulse.

        Parameters
        ----------
        timeout_s : float
            Longest time in s to wait.

        Returns
        -------
        Frame
            `image` holds the sensor's raw integers, uint8 up to 8 bits and uint16 beyond, right-justified,
            neither linearised nor averaged. It is a copy: the caller keeps it while later frames are read.
            `index` is the device's own count since `_arm` (its block or frame number less that of the first),
            so that a lost frame shows as a gap; `settings` is what `_configure` gave.

        Raises
        ------
        DeviceTimeoutError
            No frame came in time.
        FrameLossError
            The frame is torn, or not whole.
        """

    @abstractmethod
    def _stop(self) -> None:
        """Wait for no more frames and drop those not read.

        Called by `stop` in IDLE and ARMED, also when nothing is under way, and by `read` after the last
        frame.

        Raises
        ------
        DeviceError
            It does not stop.
        """


def _unit_hint(ratio: float) -> str:
    """Name the unit in which an exposure was read back, if it is not s."""
    for unit, per_s in {"ms": 1e3, "µs": 1e6}.items():
        if 0.5 < ratio / per_s < 2.0:
            return f"`_configure` gives the exposure in {unit}; it is in s; fix the driver"
    return ""


def are_settings_honoured(requested: CameraSettings, back: CameraSettings, caps: CameraCaps) -> bool:
    """Whether a device has the requested settings, but for rounding to its grid."""
    # Chosen: wide enough for exposures in steps of a sensor row and for gains in steps of 0.5 dB, and too
    # narrow for a setting that the device has ignored.
    off_s = abs(back.exposure_s - requested.exposure_s)
    exposure_is_near = off_s <= max(0.1 * requested.exposure_s, 0.5 * caps.exposure_step_s)
    return exposure_is_near and abs(back.gain_db - requested.gain_db) <= 0.5 and back.bits == requested.bits
