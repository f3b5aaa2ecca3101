"""A camera with a GenICam node map behind the interface of `fpplab.devices`: all but its frames."""

from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar, get_args

from drivers.genicam import names as named
from drivers.genicam.buffers import held_frames
from drivers.genicam.features import Features
from drivers.genicam.gain import CameraGain
from drivers.genicam.names import US_PER_S
from drivers.genicam.options import EDGES, SHUTTERS, GenicamOptions, TriggerLine
from drivers.genicam.pixels import PACKED
from fpplab.core.errors import (
    CapabilityError,
    DeviceError,
    DeviceTimeoutError,
    DisconnectedError,
    FrameLossError,
    SettingError,
    StateError,
)
from fpplab.devices import Camera, CameraCaps, CameraSettings, Trigger
from fpplab.patterns.mosaic import Bayer

READY_TIMEOUT_S = 5.0  # longest wait in s for a camera that reports when it is ready for a trigger (chosen)


class GenicamCamera(Camera):
    """A driver opens the camera, sets `_features`, `_gain` and `_options`, and calls `_set_up`."""

    FORMATS: ClassVar[dict[int, tuple[str, ...]]]
    """GenICam pixel formats by bit depth, the preferred one first; a driver states those that it decodes."""
    LIBRARY: ClassVar[str]
    LIBRARY_ERRORS: ClassVar[tuple[type[Exception], ...]]
    """The library that gives the node map, and its exceptions, which become device errors."""

    _features: Features
    _gain: CameraGain
    _options: GenicamOptions
    _raw: named.RawSettings = named.RAW
    """Settings for raw frames; a maker's driver adds its own."""
    _selected_raw = named.SELECTED_RAW
    _default_line = "Line1"  # the maker's trigger input

    @abstractmethod
    def _is_gone(self) -> bool:
        """Whether the camera was open and is no longer connected."""

    @abstractmethod
    def _is_in_use(self, error: Exception) -> bool:
        """Whether an exception says that another program has the camera open."""

    @abstractmethod
    def _cause_in_settings(self) -> tuple[str, str] | None:
        """Return what of the computer's settings loses frames of this camera, and the remedy."""

    @contextmanager
    def _guard(self, operation: str) -> Iterator[None]:
        """Translate the library's exceptions into the device errors of fpplab."""
        with super()._guard(operation):
            try:
                yield
            except self.LIBRARY_ERRORS as error:
                raise self._described(operation, error) from error

    def _described(self, operation: str, error: Exception) -> DeviceError:
        if self._is_in_use(error):
            return StateError(self.name, operation, "another program has the camera open", "close it there")
        if self._is_gone():
            return self._disconnected(operation)
        cause, remedy = self._cause_in_settings() or ("", "close it and open it again")
        problem = f"{self.LIBRARY} says: {message_of(error)}{cause and '; '}{cause}"
        return DeviceError(self.name, operation, problem, remedy)

    def _check_connected(self, operation: str) -> None:
        if self._is_gone():
            raise self._disconnected(operation)

    def _disconnected(self, operation: str) -> DisconnectedError:
        problem = "the camera was unplugged or switched off"
        return DisconnectedError(self.name, operation, problem, "plug it in and open it again")

    def _damaged(self, description: str) -> FrameLossError:
        cable = "check the cable, and the USB controller or network; take the frames again"
        cause, remedy = self._cause_in_settings() or ("", cable)
        problem = f"frame {self._taken} is damaged: {description}{cause and '; '}{cause}"
        return FrameLossError(self.name, "read", problem, remedy)

    def _never_ready(self, operation: str) -> DeviceTimeoutError:
        problem = "the camera does not become ready for a trigger"
        return DeviceTimeoutError(self.name, operation, problem, "close it and open it again")

    def _no_frame(self, trigger: Trigger, reason: str) -> DeviceTimeoutError:
        cable = "check the trigger cable; 'fpplab check' shows whether the camera was not ready yet"
        remedy = cable if trigger == "hardware" else "allow more time"
        return DeviceTimeoutError(self.name, "read", reason, remedy)

    def _set_up(self) -> None:
        """Make the camera raw, apply the rig file's options, and read what it can do."""
        self._make_raw()
        self._apply_options()
        self._present_caps = self._read_caps()

    def _caps(self) -> CameraCaps:
        return self._present_caps

    def _temperature_c(self) -> float | None:
        celsius = self._features.read(named.TEMPERATURE_C)
        return None if celsius is None else float(celsius)

    def _configure(self, settings: CameraSettings) -> CameraSettings:
        self._forget()  # settings that are refused may have been applied in part
        exposure_us = round(settings.exposure_s * US_PER_S, 6)
        self._features.write(named.PIXEL_FORMAT, self._format(settings.bits), "configure")
        back_us = self._features.write(named.EXPOSURE_US, exposure_us, "configure", tolerance=exposure_us)
        gain_db = self._gain.set_db(settings.gain_db)
        self._present_caps = self._read_caps()
        return CameraSettings(back_us / US_PER_S, gain_db, settings.bits)

    def _make_raw(self) -> None:
        features = self._features
        features.accepted = self._options.accept_raw
        for feature, value in self._raw:
            if feature != named.GAMMA or features.read(named.GAMMA_ENABLE) is not False:
                features.ensure(feature, value, "open")
        for selector, feature, value in self._selected_raw:
            for entry in features.choices(selector):
                features.write_if_possible(selector, entry)
                features.ensure(feature, value, "open")
        self._gain.neutralise_digital()
        for channels in named.ALL_CHANNELS:
            available = features.choices(channels)
            features.write_if_possible(channels, next((n for n in named.WHOLE if n in available), "All"))
        for entry in features.choices(named.TRIGGER_SELECTOR):
            features.write_if_possible(named.TRIGGER_SELECTOR, entry)
            features.write_if_possible(named.TRIGGER_MODE, "Off")
        if features.has(named.TRIGGER_SELECTOR):
            self._select_trigger("open")

    def _apply_options(self) -> None:
        options, write = self._options, self._features.write
        self._set_roi(options.roi)
        if options.black_level is not None:
            write(named.BLACK_LEVEL, options.black_level, "open", tolerance=0.5)
        if options.strobe is not None:
            write(named.LINE_SELECTOR, options.strobe, "open")
            write(named.LINE_MODE, "Output", "open")
            write(named.LINE_SOURCE, "ExposureActive", "open")
        if options.shutter is not None and self._features.has(named.SHUTTER):
            names, available = SHUTTERS[options.shutter], self._features.choices(named.SHUTTER)
            write(named.SHUTTER, next((name for name in names if name in available), names[0]), "open")

    def _set_roi(self, roi: tuple[int, int, int, int] | None) -> None:
        write = self._features.write
        write(named.OFFSET_X, 0, "open")
        write(named.OFFSET_Y, 0, "open")
        whole = (int(self._features.limits(side)[1]) for side in (named.WIDTH, named.HEIGHT))
        x, y, width, height = roi or (0, 0, *whole)
        write(named.WIDTH, width, "open")
        write(named.HEIGHT, height, "open")
        write(named.OFFSET_X, x, "open")
        write(named.OFFSET_Y, y, "open")

    def _read_caps(self) -> CameraCaps:
        features = self._features
        shortest, longest = features.limits(named.EXPOSURE_US)
        return CameraCaps(
            (features.read(named.WIDTH), features.read(named.HEIGHT)),
            tuple(bits for bits in self.FORMATS if self._formats(bits)),
            (shortest / US_PER_S, longest / US_PER_S),
            self._gain.limits_db(),
            self._triggers(),
            *self._row_times_s(),
            self._period_s(),
            (int(features.read(named.OFFSET_X) or 0), int(features.read(named.OFFSET_Y) or 0)),
            self._bayer(),
            strobe=self._options.strobe is not None,
            buffers=held_frames(features.read(named.PAYLOAD_BYTES) or self._frame_bytes()),
            exposure_step_s=features.step(named.EXPOSURE_US) / US_PER_S,
        )

    def _frame_bytes(self) -> int:
        """Return the size of a frame of 16 bits, for a camera that does not report that of its frames."""
        return 2 * int(self._features.read(named.WIDTH) * self._features.read(named.HEIGHT))

    def _period_s(self) -> float | None:
        """Return the least time in s between triggers: the reciprocal of the resulting frame rate."""
        # Basler documents that this is how long to wait after each trigger, and that an earlier one is
        # ignored.
        rate_hz = self._features.read(named.RESULTING_HZ)
        if not rate_hz:
            return None
        # Without overlap the camera takes no trigger before the frame is read out, for which the rate allows.
        apart = self._features.read(named.TRIGGER_OVERLAP) == "Off"
        return 1.0 / float(rate_hz) + (self._exposure_s() if apart else 0.0)

    def _exposure_s(self) -> float:
        return float(self._features.read(named.EXPOSURE_US)) / US_PER_S

    def _triggers(self) -> tuple[Trigger, ...]:
        """List the supported triggers: none if the camera cannot tell when it is ready for its first one."""
        if not self._can_be_triggered():
            return ()
        sources = self._features.choices(named.TRIGGER_SOURCE)
        names: dict[Trigger, str] = {"software": "Software", "hardware": self._line}
        if self._options.trigger.line is not None and self._line not in sources:
            raise SettingError(
                self.name, "open", f"trigger.line is {self._line}", f"the camera has {', '.join(sources)}"
            )
        return tuple(trigger for trigger, source in names.items() if source in sources)

    @property
    def _line(self) -> str:
        return self._options.trigger.line or self._default_line

    def _row_times_s(self) -> tuple[float, float]:
        """Return the delay in s from the first to the last row's exposure, and that of their ends alone."""
        shutter = self._features.read(named.SHUTTER) or self._options.shutter
        if shutter in ("global", *SHUTTERS["global"]):
            return 0.0, 0.0
        readout_us = self._features.read(named.READOUT_US)
        if readout_us is None and shutter is not None:
            raise CapabilityError(
                self.name,
                "open",
                f"the shutter is {shutter}, but the camera does not state its readout time",
                "use a camera with a global shutter",
            )
        readout_s = float(readout_us or 0.0) / US_PER_S
        resets = shutter in ("global_reset", *SHUTTERS["global_reset"])
        return (0.0, readout_s) if resets else (readout_s, 0.0)

    def _formats(self, bits: int) -> list[str]:
        available, bayer = self._features.choices(named.PIXEL_FORMAT), self._bayer()
        formats = (
            name.replace("Mono", f"Bayer{bayer[:2]}") if bayer else name for name in self.FORMATS[bits]
        )
        return [name for name in formats if name in available]

    def _bayer(self) -> Bayer | None:
        """The filter's colours by the raw formats, beside which Mono8 is made of several pixels."""
        formats = self._features.choices(named.PIXEL_FORMAT)
        patterns = [p for p in get_args(Bayer) if any(f.startswith(f"Bayer{p[:2]}") for f in formats)]
        return patterns[0] if patterns else None

    def _format(self, bits: int) -> str:
        formats = self._formats(bits)
        if not self._options.packed or bits != 12:
            return formats[0]
        packed = [name for name in formats if name.endswith("12p")]
        if not packed:
            raise SettingError(self.name, "configure", "packed is true", f"this camera has no {PACKED}")
        return packed[0]

    def _can_be_triggered(self) -> bool:
        """Whether it can be known when the camera is ready for its first trigger."""
        return True

    def _choose_trigger(self, trigger: Trigger) -> None:
        features, line = self._features, self._options.trigger
        hardware = trigger == "hardware"
        self._select_trigger("arm")
        features.write(named.TRIGGER_MODE, "On", "arm")
        features.write(named.TRIGGER_SOURCE, self._line if hardware else "Software", "arm")
        if hardware:
            features.write(named.TRIGGER_EDGE, EDGES[line.edge], "arm")
            self._set_up_line(line)
        delay_us = line.delay_us if hardware else 0.0
        if delay_us or features.has(named.TRIGGER_DELAY_US):
            features.write(named.TRIGGER_DELAY_US, delay_us, "arm", tolerance=1.0)

    def _select_trigger(self, operation: str) -> None:
        """Select the trigger of single frames, and let it overlap the readout where the camera can."""
        features, available = self._features, self._features.choices(named.TRIGGER_SELECTOR)
        names = [name for name in named.FRAME_TRIGGERS if name in available]
        features.write(named.TRIGGER_SELECTOR, names[0] if names else named.FRAME_TRIGGERS[0], operation)
        overlaps = features.choices(named.TRIGGER_OVERLAP)
        features.write_if_possible(
            named.TRIGGER_OVERLAP, next((name for name in named.OVERLAPS if name in overlaps), "Off")
        )

    def _set_up_line(self, line: TriggerLine) -> None:
        """Make the line an input that is neither inverted nor slower than stated."""
        features = self._features
        if not features.has(named.LINE_SELECTOR):
            return
        features.write(named.LINE_SELECTOR, self._line, "arm")
        features.ensure(named.LINE_MODE, "Input", "arm")
        features.ensure(named.LINE_INVERTER, False, "arm")
        if line.debounce_us or features.has(named.LINE_DEBOUNCER_US):
            features.write(named.LINE_DEBOUNCER_US, line.debounce_us, "arm", tolerance=1.0)


def message_of(error: Exception) -> str:
    """Return a message of GenApi without the exception's type and source location."""
    return str(error).split(" : ")[0].strip()
