"""A Basler camera behind the interface of `fpplab.devices`."""

import gc
import logging
import time
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, ClassVar, cast
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pypylon import genicam, pylon

from drivers.basler.families import BASLER_RAW, family_of, raw_gain_of
from drivers.basler.transport import Pylon, lost_on_link
from drivers.computer_settings import cause_in_settings
from drivers.genicam import buffers
from drivers.genicam import names as named
from drivers.genicam.buffers import SPARE_BUFFERS
from drivers.genicam.camera import READY_TIMEOUT_S, GenicamCamera, message_of
from drivers.genicam.features import Features
from drivers.genicam.gain import CameraGain
from drivers.genicam.options import GenicamOptions
from drivers.genicam.pixels import PACKED, unpack12
from fpplab.core import config
from fpplab.core.conventions import Image
from fpplab.core.errors import ConfigError, DeviceError, DisconnectedError
from fpplab.core.files import write_text
from fpplab.devices import DeviceInfo, Frame, State, Trigger


class BufferPool:
    """Number of grab buffers, and which of them are in use by arrays."""

    def __init__(self, waiting: int, frame_bytes: int) -> None:
        self.size = min(waiting, buffers.held_frames(frame_bytes)) + buffers.SPARE_BUFFERS
        self._lent: WeakSet[_Lease] = WeakSet()

    def image(self, result: Any) -> Image:
        """Return the pixels of a grab result as an array that only the caller holds."""
        # The array uses pylon's buffer while enough buffers remain for the transfer; otherwise, and for
        # packed formats, it is a copy.
        # returns (height, width)
        if pylon.IsPacked(result.GetPixelType()):
            packed = np.frombuffer(result.GetImageMemoryView(), np.uint8)
            return unpack12(packed, result.GetHeight(), result.GetWidth(), result.GetPaddingX())
        if len(self._lent) >= self.size - buffers.SPARE_BUFFERS:
            return cast(Image, _view_buffer(result).copy())
        lease = _Lease(result)
        self._lent.add(lease)
        return cast(Image, np.asarray(lease))


class _Lease:
    """Keeps a grab result alive for as long as an array uses its buffer."""

    def __init__(self, result: Any) -> None:
        self._view = _view_buffer(result)
        self._result = result
        self.__array_interface__ = self._view.__array_interface__


def _view_buffer(result: Any) -> NDArray[Any]:
    """Return the buffer as an array (height, width), valid while the grab result exists."""
    height, width = result.GetHeight(), result.GetWidth()
    dtype = np.dtype(np.uint8 if pylon.BitPerPixel(result.GetPixelType()) == 8 else np.uint16)
    pitch = width * dtype.itemsize + result.GetPaddingX()
    memory = result.GetImageMemoryView()
    return np.ndarray((height, width), dtype, memory, strides=(pitch, dtype.itemsize))


class BaslerOptions(GenicamOptions):
    """The camera's section in a rig file."""

    packet_bytes: Annotated[int, Field(ge=1)] | None = None
    """Size of an Ethernet camera's packets in bytes; by default unchanged."""
    packet_delay_ticks: Annotated[int, Field(ge=0)] | None = None
    """Pause between two packets of an Ethernet camera, in ticks of its clock; by default unchanged."""
    features: str | None = None
    """.pfs file with the camera's settings, loaded before all others, as saved by pylon Viewer."""


_log = logging.getLogger(__name__)

LINK_REMEDY = "use a better cable or network card, or a larger packet_delay_ticks"
"""Remedy for packets that are lost again and again."""
FIRST_BLOCK = {"BaslerGigE": 1}
"""BlockID of the first frame after `arm`, by pylon's device class, where it is not 0."""
LOCKED_S = 6.0
"""Wait in s for a network camera in use: a crashed program's lock ends after a heartbeat, pylon's 3 s."""
NO_BLOCK_ID = (1 << 64) - 1
"""BlockID of a camera that does not count its frames (pylon's API reference, `GetBlockID`)."""
USB_SPEEDS = {
    "LowSpeed": "USB 1, 1.5 Mbit/s",
    "FullSpeed": "USB 1, 12 Mbit/s",
    "HighSpeed": "USB 2, 480 Mbit/s",
    "SuperSpeed": "USB 3, 5 Gbit/s",
}
"""Descriptions of the speeds that a USB camera reports."""
IN_USE = ("exclusively opened", "controlled by another application")
"""Phrases in pylon's error messages for a camera that another program has open, over USB and Ethernet."""


class BaslerCamera(GenicamCamera):
    """A camera that pylon lists.

    An emulated bench may replace pylon's transport layers by its attribute `pylon`. Frames are delivered
    without a copy as long as buffers last (see `drivers.basler.frames`); a frame's `index` follows the
    camera's own count. `caps.readout_s` and `caps.dark_s` describe the row timing of a rolling shutter or a
    global reset.
    """

    FORMATS: ClassVar = {8: ("Mono8",), 12: ("Mono12", PACKED), 16: ("Mono16",)}
    _raw = named.RAW + BASLER_RAW
    LIBRARY: ClassVar = "pylon"
    LIBRARY_ERRORS: ClassVar = (genicam.GenericException,)

    _camera: Any = None
    _options: BaslerOptions

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        self._options = config.validate(options, BaslerOptions, self.name)
        self._transport = getattr(bench, "pylon", None) or Pylon()

    def load_features(self, path: Path) -> None:
        """Load all settings of a .pfs file; the camera must be configured again afterwards."""
        # Settings that would alter the raw sensor values (`_raw`) are reset after loading. A file that is
        # refused may have been applied in part.
        self._need(State.IDLE, doing="load_features")
        text = config.read_text(path)
        self._forget()
        with self._guard("load_features"):
            self._load(text, path)
            self._make_raw()
            self._present_caps = self._read_caps()

    def save_features(self, path: Path) -> None:
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
        self._open_when_free()
        self._features = Features(self.name, self._camera)
        info = self._camera.GetDeviceInfo()
        conversion = self._options.raw_gain or raw_gain_of(info.GetModelName())
        self._gain = CameraGain(self._features, conversion)
        self._first_block = FIRST_BLOCK.get(info.GetDeviceClass(), 0)
        self._ticks_per_s = float(
            self._features.read(named.TICKS_PER_S) or 1e9
        )  # ns, unless the camera reports another unit
        if self._options.features is not None:
            path = Path(self._options.features)
            self._load(config.read_text(path), path)
        self._warn_of_missing_nodes(info.GetModelName())
        self._set_up()

    def _open_when_free(self) -> None:
        """Open the camera; one on the network may still be locked by a program that has crashed."""
        deadline = time.monotonic() + LOCKED_S
        while True:
            try:
                self._camera.Open()
                return
            except genicam.GenericException as error:
                locked = self._link == "BaslerGigE" and self._is_in_use(error)
                if not locked or time.monotonic() >= deadline:
                    raise
            time.sleep(0.1)

    @property
    def _link(self) -> str:
        return str(self._camera.GetDeviceInfo().GetDeviceClass())

    def _cause_in_settings(self) -> tuple[str, str] | None:
        if self._camera is None:
            return None
        return cause_in_settings(usb=self._link == "BaslerUsb", ethernet=self._link == "BaslerGigE")

    def _close(self) -> None:
        camera, self._camera = self._camera, None
        if camera is None:
            return
        removed = camera.IsCameraDeviceRemoved()
        try:
            if not removed:
                camera.StopGrabbing()
                camera.Close()
        finally:
            camera.DestroyDevice()
        if removed:
            # The error that reported it keeps the camera in reference cycles of stack frames, and pylon frees
            # the camera's thread and pipes only when the object is deleted.
            del camera
            gc.collect()

    def _info(self) -> DeviceInfo:
        info = self._camera.GetDeviceInfo()
        speed = USB_SPEEDS.get(str(self._features.read(named.USB_SPEED)))
        link = ", ".join(filter(None, (info.GetDeviceClass(), speed)))
        return DeviceInfo("camera", info.GetModelName(), info.GetSerialNumber(), link)

    def _arm(self, n: int, trigger: Trigger) -> None:
        self._choose_trigger(trigger)
        # Hardware triggers do not wait for the host, software triggers do; new buffers take time to allocate.
        waiting = n if trigger == "hardware" else SPARE_BUFFERS
        self._pool = BufferPool(waiting, self._features.read(named.PAYLOAD_BYTES))
        self._trigger = trigger
        self._camera.MaxNumBuffer.SetValue(self._pool.size)
        self._camera.StartGrabbing(pylon.GrabStrategy_OneByOne)
        # A pulse that comes before the camera is ready would be lost without an error.
        self._await_ready(time.monotonic() + READY_TIMEOUT_S, "arm")

    def _read(self, timeout_s: float) -> Frame:
        deadline = time.monotonic() + timeout_s
        if self._trigger == "software":
            self._await_ready(deadline, "read")
            self._camera.ExecuteSoftwareTrigger()
        result = self._retrieve(deadline, timeout_s)
        host_time_s = time.time()
        if not result.GrabSucceeded():
            self._check_connected("read")
            raise self._damaged(f"{result.GetErrorDescription()} ({result.GetErrorCode():#x}){self._lost()}")
        index, ticks = self._index(result.GetBlockID()), result.GetTimeStamp()
        device_time_s = ticks / self._ticks_per_s if ticks else None  # 0 of a camera without a clock
        settings = self._configured("read")
        return Frame(self._pool.image(result), index, settings, host_time_s, device_time_s)

    def _stop(self) -> None:
        if self._camera.IsGrabbing() and (lost := self._lost()):
            _log.warning("%s: frames arrived, but not without repeats%s; %s", self.name, lost, LINK_REMEDY)
        self._camera.StopGrabbing()

    def _lost(self) -> str:
        """Describe what the link lost since `arm`, or return an empty string."""
        lost = lost_on_link(self._camera.GetStreamGrabberNodeMap())
        return "".join(f", {count} {what}" for what, count in lost.items())

    def _fault(self) -> None:
        """Disarm the camera at once, so that a late frame is not taken for the next one."""
        super()._fault()
        if self._camera is not None:
            with suppress(genicam.GenericException):  # the original fault is the one to report
                self._camera.StopGrabbing()

    def _is_in_use(self, error: Exception) -> bool:
        return any(phrase in str(error) for phrase in IN_USE)

    def _load(self, text: str, path: Path) -> None:
        try:
            pylon.FeaturePersistence.LoadFromString(text, self._camera.GetNodeMap(), True)
        except genicam.GenericException as error:
            self._check_connected("load_features")
            raise ConfigError(
                f"{path}: does not fit the camera '{self.name}': {message_of(error)}"
            ) from error

    def _apply_options(self) -> None:
        super()._apply_options()
        options = self._options
        for feature, value in (
            (named.PACKET_BYTES, options.packet_bytes),
            (named.PACKET_DELAY_TICKS, options.packet_delay_ticks),
        ):
            if value is not None:
                self._features.write(feature, value, "open")

    def _warn_of_missing_nodes(self, model: str) -> None:
        """Warn where a camera lacks what its family has: what such a feature does is not known then."""
        family = family_of(model)
        missing = [name for name in family.nodes if not self._features.has((name,))] if family else []
        if family and missing:
            text = "%s: %s has no %s, which other cameras of its family (%s) have; is its firmware current?"
            _log.warning(text, self.name, model, " and no ".join(missing), family.name)

    def _can_be_triggered(self) -> bool:
        return bool(self._camera.CanWaitForFrameTriggerReady())

    def _await_ready(self, deadline: float, operation: str) -> None:
        """Wait until the camera is ready for a trigger; it drops an earlier one without an error."""
        # On pylon's emulator 19 of 30 first triggers were lost without this wait, and 0 of 500 with it.
        while not self._camera.WaitForFrameTriggerReady(_slice_ms(deadline), pylon.TimeoutHandling_Return):
            self._check_connected(operation)
            if time.monotonic() >= deadline:
                raise self._never_ready(operation)

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
        raise self._no_frame(self._trigger, f"no frame came within {timeout_s:g} s{self._lost()}")

    def _index(self, block_id: int) -> int:
        """Return the frame's number since `arm`, by the camera's own count where it has one."""
        return self._taken if block_id == NO_BLOCK_ID else block_id - self._first_block

    def _is_gone(self) -> bool:
        if self._camera is None:
            return False
        # pylon sometimes misses a removal, so the list of connected cameras is checked too.
        return self._camera.IsCameraDeviceRemoved() or self._options.serial not in self._transport.cameras()


class CameraAsLeft(BaslerCamera):
    """A camera that opening leaves unchanged, except for the triggers, which pylon itself switches off."""

    def _make_raw(self) -> None:
        """Leave gamma and other image processing as they are."""

    def _apply_options(self) -> None:
        """Leave the region of interest as it is."""


def _slice_ms(deadline: float) -> int:
    """Time to wait in pylon, in ms: short, as it notices neither an unplugged camera nor Ctrl-C meanwhile."""
    return round(1000 * min(max(deadline - time.monotonic(), 0.0), 0.2))
