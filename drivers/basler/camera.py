"""A Basler camera behind the interface of `fpplab.devices`.

`drivers.basler.options` describes its section in a rig file. The driver is not specific to a model: the
camera's GenICam node map is queried for the features that it has.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pypylon import genicam, pylon

from drivers.basler import features as named
from drivers.basler.features import US_PER_S, Features
from drivers.basler.frames import SPARE, BufferPool
from drivers.basler.gain import CameraGain
from drivers.basler.options import EDGES, SHUTTERS, BaslerOptions, TriggerLine
from drivers.basler.transport import Pylon
from fpplab.core import config
from fpplab.core.errors import (
    CapabilityError,
    ConfigError,
    DeviceError,
    DeviceTimeoutError,
    DisconnectedError,
    FrameLossError,
    SettingError,
    StateError,
)
from fpplab.core.files import write_text
from fpplab.devices import Camera, CameraCaps, CameraSettings, DeviceInfo, Frame, State, Trigger

NS_PER_S = 1e9
READY_S = 5.0
"""Time limit in s for a camera to become ready for its first trigger."""
SLICE_S = 0.2
"""Interval in s at which a wait checks for an unplugged camera and for the operator's Ctrl-C."""
FIRST_BLOCK = {"BaslerGigE": 1}
"""BlockID of the first frame after `arm`, by pylon's device class, where it is not 0."""
NO_BLOCK_ID = (1 << 64) - 1
"""BlockID that pylon reports for a camera that does not count its frames."""
USB_SPEEDS = {
    "LowSpeed": "USB 1, 1.5 Mbit/s",
    "FullSpeed": "USB 1, 12 Mbit/s",
    "HighSpeed": "USB 2, 480 Mbit/s",
    "SuperSpeed": "USB 3, 5 Gbit/s",
}
"""Descriptions of the speeds that a USB camera reports."""
IN_USE = ("exclusively opened", "controlled by another application")
"""Phrases in pylon's error messages for a camera that another program has open, over USB and Ethernet."""

FORMATS: dict[int, tuple[str, ...]] = {8: ("Mono8",), 12: ("Mono12", "Mono12p"), 16: ("Mono16",)}
"""GenICam pixel formats by bit depth, the preferred one first."""


class BaslerCamera(Camera):
    """A camera that pylon lists.

    An emulated bench may replace pylon's transport layers by its attribute `pylon`. Frames are delivered
    without a copy as long as buffers last (see `drivers.basler.frames`); a frame's `index` follows the
    camera's own count. `caps.readout_s` and `caps.dark_s` describe the row timing of a rolling shutter or a
    global reset.
    """

    _camera: Any = None

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        self._options = config.validate(options, BaslerOptions, self.name)
        self._transport = getattr(bench, "pylon", None) or Pylon()

    def load_features(self, path: Path) -> None:
        """Load all settings of a .pfs file; the camera must be configured again afterwards.

        Settings that would alter the raw sensor values (`drivers.basler.features.RAW`) are reset after
        loading. A file that is refused may have been applied in part.

        Parameters
        ----------
        path : Path
            .pfs file, as saved by `save_features` or pylon Viewer.

        Raises
        ------
        StateError
            Frames are being taken, or the camera is not open.
        ConfigError
            The file cannot be read, or does not fit the camera.
        DisconnectedError
            The camera was unplugged.
        """
        self._need(State.IDLE, doing="load_features")
        text = config.read_text(path)
        self._forget()
        with self._guard("load_features"):
            self._load(text, path)
            self._make_raw()
            self._known = self._read_caps()

    def save_features(self, path: Path) -> None:
        """Write all settings of the camera to a .pfs file.

        Parameters
        ----------
        path : Path
            File to write.

        Raises
        ------
        StateError
            Frames are being taken, or the camera is not open.
        DisconnectedError
            The camera was unplugged.
        """
        self._need(State.IDLE, doing="save_features")
        with self._guard("save_features"):
            text = pylon.FeaturePersistence.SaveToString(self._camera.GetNodeMap())
        write_text(path, text)

    def _open(self) -> None:
        serial, connected = self._options.serial, self._transport.cameras()
        if serial not in connected:
            raise DisconnectedError(
                self.name,
                "open",
                f"no camera with the serial number {serial} is connected",
                f"there is {', '.join(connected) or 'none'}",
            )
        self._camera = self._transport.attach(connected[serial])
        self._camera.Open()
        self._features = Features(self.name, self._camera)
        self._gain = CameraGain(self._features, self._options.raw_gain)
        self._first_block = FIRST_BLOCK.get(self._camera.GetDeviceInfo().GetDeviceClass(), 0)
        self._ticks_per_s = float(self._features.read(named.TICKS_PER_S) or NS_PER_S)
        if self._options.features is not None:
            path = Path(self._options.features)
            self._load(config.read_text(path), path)
        self._make_raw()
        self._apply_options()
        self._known = self._read_caps()

    def _close(self) -> None:
        camera, self._camera = self._camera, None
        if camera is None:
            return
        try:
            if not camera.IsCameraDeviceRemoved():
                camera.StopGrabbing()
                camera.Close()
        finally:
            camera.DestroyDevice()

    def _info(self) -> DeviceInfo:
        info = self._camera.GetDeviceInfo()
        speed = USB_SPEEDS.get(str(self._features.read(named.USB_SPEED)))
        link = ", ".join(filter(None, (info.GetDeviceClass(), speed)))
        return DeviceInfo("camera", info.GetModelName(), info.GetSerialNumber(), link)

    def _caps(self) -> CameraCaps:
        return self._known

    def _configure(self, settings: CameraSettings) -> CameraSettings:
        self._forget()  # settings that are refused may have been applied in part
        exposure_us = round(settings.exposure_s * US_PER_S, 6)
        self._features.write(named.PIXEL_FORMAT, self._format(settings.bits), "configure")
        back_us = self._features.write(named.EXPOSURE_US, exposure_us, "configure", tolerance=exposure_us)
        gain_db = self._gain.set_db(settings.gain_db)
        self._known = self._read_caps()
        return CameraSettings(back_us / US_PER_S, gain_db, settings.bits)

    def _arm(self, n: int, trigger: Trigger) -> None:
        self._choose_trigger(trigger)
        # Hardware triggers do not wait for the host, software triggers do; new buffers take time to allocate.
        waiting = n if trigger == "hardware" else SPARE
        self._pool = BufferPool(waiting, self._features.read(named.PAYLOAD_BYTES))
        self._trigger = trigger
        self._camera.MaxNumBuffer.SetValue(self._pool.size)
        self._camera.StartGrabbing(pylon.GrabStrategy_OneByOne)
        # A pulse that comes before the camera is ready would be lost without an error.
        self._await_ready(time.monotonic() + READY_S, "arm")

    def _read(self, timeout_s: float) -> Frame:
        deadline = time.monotonic() + timeout_s
        if self._trigger == "software":
            self._await_ready(deadline, "read")
            self._camera.ExecuteSoftwareTrigger()
        result = self._retrieve(deadline, timeout_s)
        host_time_s = time.time()
        if not result.GrabSucceeded():
            self._check_connected("read")
            said = f"{result.GetErrorDescription()} ({result.GetErrorCode():#x})"
            raise FrameLossError(
                self.name,
                "read",
                f"frame {self._taken} is damaged: {said}",
                "check the cable and the USB controller, and take the frames again",
            )
        index, ticks = self._index(result.GetBlockID()), result.GetTimeStamp()
        device_time_s = ticks / self._ticks_per_s if ticks else None
        settings = self._configured("read")
        return Frame(self._pool.image(result), index, settings, host_time_s, device_time_s)

    def _stop(self) -> None:
        self._camera.StopGrabbing()

    def _fault(self) -> None:
        """Disarm the camera at once, so that a late frame is not taken for the next one."""
        super()._fault()
        if self._camera is not None:
            with suppress(genicam.GenericException):  # the original fault is the one to report
                self._camera.StopGrabbing()

    @contextmanager
    def _guard(self, operation: str) -> Iterator[None]:
        """Translate pylon's exceptions into the device errors of fpplab."""
        with super()._guard(operation):
            try:
                yield
            except genicam.GenericException as error:
                raise self._described(operation, error) from error

    def _described(self, operation: str, error: genicam.GenericException) -> DeviceError:
        said = str(error)
        if any(phrase in said for phrase in IN_USE):
            return StateError(self.name, operation, "another program has the camera open", "close it there")
        if self._camera is not None and self._is_gone():
            return self._disconnected(operation)
        return DeviceError(self.name, operation, f"pylon says: {_words(error)}", "close it and open it again")

    def _load(self, text: str, path: Path) -> None:
        try:
            pylon.FeaturePersistence.LoadFromString(text, self._camera.GetNodeMap(), True)
        except genicam.GenericException as error:
            self._check_connected("load_features")
            raise ConfigError(f"{path}: does not fit the camera '{self.name}': {_words(error)}") from error

    def _make_raw(self) -> None:
        features = self._features
        for channels in named.ALL_CHANNELS:
            features.write_if_possible(channels, "All")
        for feature, value in named.RAW:
            if feature != named.GAMMA or features.read(named.GAMMA_ENABLE) is not False:
                features.ensure(feature, value, "open")
        for selector in self._features.choices(named.TRIGGER_SELECTOR):
            self._features.write_if_possible(named.TRIGGER_SELECTOR, selector)
            self._features.write_if_possible(named.TRIGGER_MODE, "Off")

    def _apply_options(self) -> None:
        options, write = self._options, self._features.write
        self._set_roi(options.roi)
        if options.black_level is not None:
            write(named.BLACK_LEVEL, options.black_level, "open", tolerance=0.5)
        if options.shutter is not None and self._features.has(named.SHUTTER):
            names, known = SHUTTERS[options.shutter], self._features.choices(named.SHUTTER)
            write(named.SHUTTER, next((name for name in names if name in known), names[0]), "open")

    def _set_roi(self, roi: tuple[int, int, int, int] | None) -> None:
        write = self._features.write
        write(named.OFFSET_X, 0, "open")
        write(named.OFFSET_Y, 0, "open")
        whole = (int(self._features.limits(named.WIDTH)[1]), int(self._features.limits(named.HEIGHT)[1]))
        left, top, width, height = roi or (0, 0, *whole)
        write(named.WIDTH, width, "open")
        write(named.HEIGHT, height, "open")
        write(named.OFFSET_X, left, "open")
        write(named.OFFSET_Y, top, "open")

    def _read_caps(self) -> CameraCaps:
        features = self._features
        shortest, longest = features.limits(named.EXPOSURE_US)
        return CameraCaps(
            (features.read(named.WIDTH), features.read(named.HEIGHT)),
            tuple(bits for bits in FORMATS if self._formats(bits)),
            (shortest / US_PER_S, longest / US_PER_S),
            self._gain.limits_db(),
            self._triggers(),
            *self._row_times_s(),
            self._period_s(),
        )

    def _period_s(self) -> float | None:
        """Return the least time in s between triggers: the reciprocal of the resulting frame rate.

        Basler documents that this is how long to wait after each trigger, and that an earlier one is ignored.
        """
        rate_hz = self._features.read(named.RESULTING_HZ)
        return 1.0 / rate_hz if rate_hz else None

    def _triggers(self) -> tuple[Trigger, ...]:
        """List the supported triggers: none if the camera cannot tell when it is ready for its first one."""
        if not self._camera.CanWaitForFrameTriggerReady():
            return ()
        sources = self._features.choices(named.TRIGGER_SOURCE)
        names: dict[Trigger, str] = {"software": "Software", "hardware": self._options.trigger.line}
        return tuple(trigger for trigger, source in names.items() if source in sources)

    def _row_times_s(self) -> tuple[float, float]:
        """Return the delay in s from the first to the last row's exposure, and that of their ends alone."""
        shutter = self._features.read(named.SHUTTER) or self._options.shutter
        if shutter in ("Global", "global"):
            return 0.0, 0.0
        readout_us = self._features.read(named.READOUT_US)
        if readout_us is None and shutter is not None:
            raise CapabilityError(
                self.name,
                "open",
                f"the shutter is {shutter}, but the camera does not tell its readout time",
                "use a camera with a global shutter",
            )
        readout_s = float(readout_us or 0.0) / US_PER_S
        resets = shutter in ("global_reset", *SHUTTERS["global_reset"])
        return (0.0, readout_s) if resets else (readout_s, 0.0)

    def _formats(self, bits: int) -> list[str]:
        known = self._features.choices(named.PIXEL_FORMAT)
        return [name for name in FORMATS[bits] if name in known]

    def _format(self, bits: int) -> str:
        formats = self._formats(bits)
        if not self._options.packed or bits != 12:
            return formats[0]
        if "Mono12p" not in formats:
            raise SettingError(self.name, "configure", "packed is true", "this camera has no Mono12p")
        return "Mono12p"

    def _choose_trigger(self, trigger: Trigger) -> None:
        features, line = self._features, self._options.trigger
        hardware = trigger == "hardware"
        features.write(named.TRIGGER_SELECTOR, "FrameStart", "arm")
        features.write(named.TRIGGER_MODE, "On", "arm")
        features.write(named.TRIGGER_SOURCE, line.line if hardware else "Software", "arm")
        if hardware:
            features.write(named.TRIGGER_EDGE, EDGES[line.edge], "arm")
            self._set_up_line(line)
        delay_us = line.delay_us if hardware else 0.0
        if delay_us or features.has(named.TRIGGER_DELAY_US):
            features.write(named.TRIGGER_DELAY_US, delay_us, "arm", tolerance=1.0)

    def _set_up_line(self, line: TriggerLine) -> None:
        """Make the line an input that is neither inverted nor slower than stated."""
        features = self._features
        if not features.has(named.LINE_SELECTOR):
            return
        features.write(named.LINE_SELECTOR, line.line, "arm")
        features.ensure(named.LINE_MODE, "Input", "arm")
        features.ensure(named.LINE_INVERTER, False, "arm")
        if line.debounce_us or features.has(named.LINE_DEBOUNCER_US):
            features.write(named.LINE_DEBOUNCER_US, line.debounce_us, "arm", tolerance=1.0)

    def _await_ready(self, deadline: float, operation: str) -> None:
        """Wait until the camera is ready for a trigger; it drops an earlier one without an error."""
        while not self._camera.WaitForFrameTriggerReady(_slice_ms(deadline), pylon.TimeoutHandling_Return):
            self._check_connected(operation)
            if time.monotonic() >= deadline:
                raise DeviceTimeoutError(
                    self.name,
                    operation,
                    "the camera does not become ready for a trigger",
                    "close it and open it again",
                )

    def _retrieve(self, deadline: float, timeout_s: float) -> Any:
        while True:
            result = self._camera.RetrieveResult(_slice_ms(deadline), pylon.TimeoutHandling_Return)
            if result.IsValid():
                return result
            if self._camera.IsCameraDeviceRemoved():
                raise self._disconnected("read")
            if not self._camera.IsGrabbing():
                raise DeviceError(self.name, "read", "pylon stopped grabbing", "close it and open it again")
            if time.monotonic() >= deadline:
                break
        self._check_connected("read")
        cable = "check the trigger cable; 'fpplab check' tells whether the camera was not ready yet"
        remedy = cable if self._trigger == "hardware" else "allow more time"
        raise DeviceTimeoutError(self.name, "read", f"no frame came within {timeout_s:g} s", remedy)

    def _index(self, block_id: int) -> int:
        """Return the frame's number since `arm`, by the camera's own count where it has one."""
        return self._taken if block_id == NO_BLOCK_ID else block_id - self._first_block

    def _check_connected(self, operation: str) -> None:
        if self._is_gone():
            raise self._disconnected(operation)

    def _is_gone(self) -> bool:
        # pylon sometimes misses a removal, so the list of connected cameras is checked too.
        return self._camera.IsCameraDeviceRemoved() or self._options.serial not in self._transport.cameras()

    def _disconnected(self, operation: str) -> DisconnectedError:
        return DisconnectedError(
            self.name, operation, "the camera was unplugged or switched off", "plug it in and open it again"
        )


class CameraAsLeft(BaslerCamera):
    """A camera that opening leaves unchanged, except for the triggers, which pylon itself switches off."""

    def _make_raw(self) -> None:
        """Leave gamma and other image processing as they are."""

    def _apply_options(self) -> None:
        """Leave the region of interest as it is."""


def _words(error: genicam.GenericException) -> str:
    """Return pylon's message without the exception's type and source location."""
    return str(error).split(" : ")[0].strip()


def _slice_ms(deadline: float) -> int:
    return round(1000 * min(max(deadline - time.monotonic(), 0.0), SLICE_S))
