"""Any GenICam camera behind the interface of `fpplab.devices`, through a GenTL producer.

The camera must have an exposure that can be set, a trigger of single frames, and Mono or Bayer pixels.
"""

import time
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

from genicam import genapi, gentl

from drivers.computer_settings import cause_in_settings
from drivers.genicam import names as named
from drivers.genicam.buffers import SPARE_BUFFERS
from drivers.genicam.camera import READY_TIMEOUT_S, GenicamCamera
from drivers.genicam.features import Features
from drivers.genicam.gain import CameraGain
from drivers.genicam.options import GenicamOptions, RawGain
from drivers.genicam.pixels import PACKED
from drivers.gentl.makers import maker_of
from drivers.gentl.producer import GentlFrame, GentlProducer, IncompleteBufferError
from fpplab.core import config
from fpplab.core.errors import CapabilityError, DisconnectedError
from fpplab.devices import CameraCaps, DeviceInfo, Frame, Trigger


class GentlOptions(GenicamOptions):
    """The camera's section in a rig file."""

    producer: Path
    """.cti file of the maker's GenTL producer."""


READY_S = 0.1  # time in s after which a camera that does not report readiness counts as ready (chosen)
WAITING = "FrameTriggerWait"
"""Value of the selector of `AcquisitionStatus` by which a camera reports that it waits for a trigger."""


class GentlCamera(GenicamCamera):
    """A camera that a GenTL producer lists; an emulated bench may be the producer by its `gentl`."""

    FORMATS: ClassVar = {8: ("Mono8",), 10: ("Mono10",), 12: ("Mono12", PACKED), 16: ("Mono16",)}
    LIBRARY: ClassVar = "GenICam"
    LIBRARY_ERRORS: ClassVar = (genapi.GenericException, gentl.GenericException)

    _options: GentlOptions
    _producer: Any = None
    _end: Any = None

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        self._options = config.validate(options, GentlOptions, self.name)
        self._load = getattr(bench, "gentl", None) or GentlProducer

    def _open(self) -> None:
        self._producer = self._load(self._options.producer)
        serial, connected = self._options.serial, self._producer.cameras()
        if serial not in connected:
            raise DisconnectedError(
                self.name,
                "open",
                f"the GenTL producer lists no camera with the serial number {serial}",
                f"there is {', '.join(connected) or 'none'}",
            )
        self._end = self._producer.attach(connected[serial])
        self._features = Features(self.name, self._end)
        self._need_exposure()
        self._maker = maker = maker_of(self._end.vendor)
        self._raw, self._selected_raw = named.RAW + maker.raw, maker.selected_raw
        self._default_line = maker.line
        in_db = self._features.unit(named.GAIN_DB) in (None, "dB") and not maker.gain_is_factor
        factor = RawGain(unity=1.0) if maker.gain_is_factor else None
        self._gain = CameraGain(self._features, self._options.raw_gain or factor, in_db)
        self._set_up()

    def _need_exposure(self) -> None:
        """Refuse a camera whose exposure cannot be set."""
        if not self._features.has(named.EXPOSURE_US):
            raise CapabilityError(
                self.name,
                "open",
                f"{self._end.model} has neither ExposureTime nor ExposureTimeAbs: its exposure cannot be set",
                "use a camera whose exposure can be set",
            )

    def _close(self) -> None:
        producer, end, self._producer, self._end = self._producer, self._end, None, None
        try:
            if end is not None:
                end.stop()
                end.close()
        finally:
            if producer is not None:
                producer.close()

    def _info(self) -> DeviceInfo:
        return DeviceInfo("camera", self._end.model, self._options.serial, self._end.link)

    def _read_caps(self) -> CameraCaps:
        caps = super()._read_caps()
        if not caps.bits:
            formats = ", ".join(self._features.choices(named.PIXEL_FORMAT)) or "not stated"
            raise CapabilityError(
                self.name,
                "open",
                f"its pixel formats are {formats}",
                "a camera that delivers Mono or Bayer pixels of 8 to 16 bits is needed",
            )
        return caps

    def _period_s(self) -> float | None:
        told_s = super()._period_s()
        if told_s or not self._maker.rate_is_limit or not self._features.has(named.FRAME_RATE_HZ):
            return told_s
        # Nothing says that such a camera takes a trigger while it reads the frame before.
        return self._exposure_s() + 1.0 / self._features.limits(named.FRAME_RATE_HZ)[1]

    def _arm(self, n: int, trigger: Trigger) -> None:
        self._choose_trigger(trigger)
        self._trigger, self._first = trigger, self._end.first_number
        self._end.start(n if trigger == "hardware" else SPARE_BUFFERS)
        self._ready_s = time.monotonic() + READY_S
        self._await_ready("arm")

    def _read(self, timeout_s: float) -> Frame:
        if self._trigger == "software":
            self._await_ready("read")
            self._features.execute(named.SOFTWARE_TRIGGER, "read")
            self._ready_s = time.monotonic() + (self._present_caps.period_s or 0.0)
        try:
            frame: GentlFrame | None = self._end.fetch(timeout_s)
        except IncompleteBufferError as error:
            raise self._damaged("only a part of its data came") from error
        host_time_s = time.time()
        if frame is None:
            self._check_connected("read")
            raise self._no_frame(self._trigger, f"no frame came within {timeout_s:g} s")
        if self._first is None:
            self._first = frame.number
        settings = self._configured("read")
        return Frame(frame.image, frame.number - self._first, settings, host_time_s, frame.time_s)

    def _stop(self) -> None:
        self._end.stop()

    def _fault(self) -> None:
        """Disarm the camera at once, so that a late frame is not taken for the next one."""
        super()._fault()
        if self._end is not None:
            with suppress(*self.LIBRARY_ERRORS):  # the original fault is the one to report
                self._end.stop()

    def _await_ready(self, operation: str) -> None:
        """Wait until the camera takes a trigger: until it reports so, or for as long as it may need."""
        features = self._features
        if WAITING not in features.choices(named.STATUS_SELECTOR):
            time.sleep(max(0.0, self._ready_s - time.monotonic()))
            return
        features.write(named.STATUS_SELECTOR, WAITING, operation)
        deadline = time.monotonic() + READY_TIMEOUT_S
        while not features.read(named.STATUS):
            if time.monotonic() >= deadline:
                raise self._never_ready(operation)
            time.sleep(0.001)

    def _cause_in_settings(self) -> tuple[str, str] | None:
        link = "" if self._end is None else self._end.link
        return cause_in_settings(usb="U3V" in link, ethernet="GEV" in link)

    def _is_in_use(self, error: Exception) -> bool:
        return isinstance(error, gentl.ResourceInUseException | gentl.AccessDeniedException)

    def _is_gone(self) -> bool:
        if self._end is None:
            return False
        try:
            return self._options.serial not in self._producer.cameras()
        except self.LIBRARY_ERRORS:
            return True
