"""The DLPC350 apart from its sequences: identity, power, light, trigger outputs, display mode, video.

Commands are sent, awaited, and their effect is verified. Every wait has a time limit.

Source: TI's DLPC350 client, GUI and SDK, and what their users report. Not yet tested on a board.
"""

import logging
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass

from drivers.clock import Clock, Polling
from drivers.dlp4500 import protocol
from drivers.dlp4500.layout import Command, Values
from drivers.dlp4500.protocol import COLOURS, DisplayMode, Run
from drivers.dlp4500.sequence import SIZE
from drivers.dlp4500.transport import Link
from fpplab.core.errors import DeviceError, DeviceTimeoutError, ProtocolError, SettingError, StateError

_log = logging.getLogger(__name__)

HARDWARE_FAULTS = {
    "reset_controller_error": "overlapping resets of the mirrors",
    "forced_swap_error": "an image was not loaded in time and an older one was shown",
    "sequencer_aborted": "the sequencer aborted on an error",
    "sequencer_error": "an error of the sequencer",
}
"""Faults by field of the hardware status."""
MAIN_STATES = {
    "parked": ("mirrors parked", "mirrors not parked"),
    "running": ("sequence running", "sequence stopped"),
    "frozen": ("frame buffer frozen", "frame buffer free"),
    "gamma": ("gamma correction on", "gamma correction off"),
}
"""Descriptions of the set and the cleared bit, by field of the main status."""
VALIDATION_ERRORS = {
    "exposure_invalid": "exposure or period is not valid",
    "pattern_invalid": "a pattern number or an image is not valid",
}
"""Reasons why a sequence cannot run, by field of the validation."""
VALIDATION_WARNINGS = {
    "trigger_overlap": "trigger output 1 would stay high during inserted black",
    "black_missing": "no black before an externally triggered pattern",
    "gap_too_short": "the period is less than 230 µs longer than the exposure",
}
"""Reasons why a sequence may not run as intended, by field of the validation."""


@dataclass(frozen=True)
class Status:
    """Replies to the three status commands."""

    hardware: Values  # fields of `protocol.HARDWARE_STATUS`
    system: Values  # fields of `protocol.SYSTEM_STATUS`
    main: Values  # fields of `protocol.MAIN_STATUS`

    @property
    def faults(self) -> list[str]:
        """Descriptions of all faults; empty for a healthy projector."""
        faults = [] if self.hardware["initialised"] else ["the controller did not initialise"]
        faults += hardware_faults(self.hardware)
        return faults if self.system["memory_test_passed"] else [*faults, "the memory test failed"]

    @property
    def descriptions(self) -> list[str]:
        """Descriptions of what the projector is doing, followed by its faults."""
        states = [texts[0 if self.main[name] else 1] for name, texts in MAIN_STATES.items()]
        return states + self.faults


def hardware_faults(hardware: Values) -> list[str]:
    return [description for name, description in HARDWARE_FAULTS.items() if hardware[name]]


def validation_messages(validation: Values, descriptions: Mapping[str, str]) -> list[str]:
    """Describe the errors that a finished validation reports."""
    return [description for name, description in descriptions.items() if validation[name]]


LED_FULL = 255
"""Level of an LED at full current (8 bits), as the operator sets it; the wire's may be inverted."""
PARALLEL_24_BIT = {"source": 0, "width": 1}  # input source: the parallel port, 24 bits wide
INTERNAL_TEST_PATTERN = {"source": 1, "width": 1}  # input source: the internal test pattern
BOARD_CHANNEL_SWAP = {"swap": 4, "port": 0}
"""Colour channels of the HDMI input of the evaluation module; others permute the patterns of a frame."""

MODE_CHANGE = Polling(step_s=0.1, limit_s=2.0)
"""Of the display mode. TI's GUI asks every 0.1 s and gives up after 0.7 s; the limit is chosen longer."""
STOPPING = Polling(step_s=0.01, limit_s=2.0)  # of the sequence (chosen: TI's GUI waits without a limit)
LOCKING = Polling(step_s=0.1, limit_s=1.5)  # of the video signal, as in TI's GUI
LOAD_TIMING = Polling(step_s=0.01, limit_s=1.0)  # of an image; until it is measured it reads 0 (chosen)
WAKING = Polling(step_s=0.1, limit_s=5.0)  # from standby: TI's GUI allows 2 s, other clients up to 5 s


WHOLE_AREA = {
    f"{part}_{side}": extent
    for part in ("crop", "display")
    for side, extent in (("pixel", 0), ("line", 0), ("pixels", SIZE[0]), ("lines", SIZE[1]))
}
"""A frame of the video port as it is on the mirrors."""
NO_DELAY = {"rising": protocol.ZERO_DELAY_CODE, "falling": protocol.ZERO_DELAY_CODE}
SETTINGS: tuple[tuple[Command, Values], ...] = (
    (protocol.LONG_AXIS_FLIP, {"on": 0}),
    (protocol.SHORT_AXIS_FLIP, {"on": 0}),
    (protocol.FREEZE, {"on": 0}),
    (protocol.INVERT, {"on": 0}),
    (protocol.LED_POLARITY, {"inverted": 0}),
    *((delays, NO_DELAY) for delays in protocol.LED_DELAYS.values()),
    (protocol.TRIGGER_IN_1, {"delay": 0}),
    (protocol.TRIGGER_IN_2, {"inverted": 0}),
)
"""What other programs may have set that alters the light or when it comes, with the values of this driver."""


def delay_code(us: float) -> int:
    return protocol.ZERO_DELAY_CODE + round(us / protocol.DELAY_STEP_US)


class ProjectorBoard:
    """The DLPC350 behind a link, without sequences; commands raise the errors of `Link.write` and `read`."""

    def __init__(self, link: Link, clock: Clock, name: str) -> None:
        self.link, self._clock, self._name = link, clock, name
        self._warnings: list[str] = []

    # --- status and power

    def status(self) -> Status:
        link = self.link
        return Status(
            link.read(protocol.HARDWARE_STATUS),
            link.read(protocol.SYSTEM_STATUS),
            link.read(protocol.MAIN_STATUS),
        )

    def check_health(self) -> None:
        """Check that the controller has initialised and passed its memory test."""
        status = self.status()
        if not (status.hardware["initialised"] and status.system["memory_test_passed"]):
            raise DeviceError(self._name, "open", "; ".join(status.faults), "switch the projector off and on")

    def version(self, firmware_part: str = "application") -> str:
        read = self.link.read(protocol.VERSION)
        return ".".join(str(read[f"{firmware_part}_{field}"]) for field in ("major", "minor", "patch"))

    def firmware_tag(self) -> str:
        return self.link.read_bytes(protocol.FIRMWARE_TAG).split(b"\0")[0].decode("ascii", "replace")

    def is_standby(self) -> bool:
        return bool(self.link.read(protocol.POWER)["standby"])

    def wake(self) -> None:
        """Leave standby and wait for it."""
        with suppress(
            DeviceTimeoutError, ProtocolError
        ):  # its reply often fails while the projector wakes; the state is read below
            self.link.write(protocol.POWER, standby=0)

        def awake() -> bool:
            with suppress(DeviceTimeoutError):
                return not self.is_standby()
            return False

        self._poll_until(awake, "wake", "is still in standby", WAKING)

    def enter_standby(self) -> None:
        """Switch the light off and enter standby, which is possible from video mode only."""
        self.go_dark()
        self.set_display_mode(DisplayMode.VIDEO)
        self.link.write(protocol.POWER, standby=1)
        self._poll_until(self.is_standby, "standby", "is still awake", WAKING)

    def reset(self) -> None:
        """Restart the controller and close the link: the USB device disappears and must be opened again."""
        self.go_dark()
        self.link.write(protocol.SOFTWARE_RESET)
        self.link.close()
        self._clock.sleep(5.0)  # as TI's GUI waits before it opens the device again

    # --- light

    def set_led_levels(self, levels: Mapping[str, int], inverted: bool) -> None:
        for colour in COLOURS:
            if not 0 <= levels[colour] <= LED_FULL:
                raise SettingError(
                    self._name, "LED current", f"{colour} is {levels[colour]}", f"0 to {LED_FULL}"
                )
        # TI documents 255 as full current, but on the evaluation module it is off, and 0 the brightest.
        self.link.write(
            protocol.LED_CURRENT,
            **{colour: LED_FULL - levels[colour] if inverted else levels[colour] for colour in COLOURS},
        )

    def switch_on_leds(self, colours: Collection[str]) -> None:
        """Switch LEDs on by hand, without a sequence, at the currents that are set; the others are off."""
        self.link.write(
            protocol.LED_ENABLE, sequenced=0, **{colour: int(colour in colours) for colour in COLOURS}
        )

    def leds_off(self) -> None:
        """Switch all LEDs off, whatever the sequencer does."""
        self.link.write(protocol.LED_ENABLE, red=0, green=0, blue=0, sequenced=0)

    def go_dark(self) -> None:
        """Switch the LEDs off, then stop the sequence."""
        # Each is tried twice, and the sequence is stopped even if the LEDs could not be switched off.
        with ExitStack() as both:
            both.callback(self._try_twice, self.stop)
            both.callback(self._try_twice, self.leds_off)  # callbacks run in reverse: this one first

    @contextmanager
    def dark_on_failure(self) -> Iterator[None]:
        """Switch the light off if the code in the context fails."""
        # If the light cannot be switched off, a note is added to the original exception, which is raised in
        # any case.
        try:
            yield
        except BaseException as error:
            try:
                self.go_dark()
            except DeviceError as still_lit:
                error.add_note(f"and its light could not be switched off: {still_lit}")
            raise

    @staticmethod
    def _try_twice(order: Callable[[], None]) -> None:
        try:
            order()
        except (ProtocolError, DeviceTimeoutError):
            order()

    # --- input and triggers

    def reset_settings(self) -> None:
        """Undo what other programs have set; the LEDs must be off, as polarity may invert their currents."""
        for command, values in SETTINGS:
            self._reset(command, values)
        if self.status().main["gamma"]:  # TI's client for this board does not know the command
            self._reset(protocol.GAMMA, {"table": 0, "on": 0})

    def _reset(self, command: Command, values: Values) -> None:
        with suppress(ProtocolError):  # what it was is only told; a board need not answer
            before = self.link.read(command)
            if before != values:
                _log.info("%s: %s was %s, is set to %s", self._name, command.name, before, values)
        self.link.write(command, **values)

    def set_trigger_out_1(self, inverted: bool, rising_us: float, falling_us: float) -> None:
        """Configure trigger output 1, which is active while a pattern is shown."""
        self.link.write(
            protocol.TRIGGER_OUT_1,
            inverted=int(inverted),
            rising=delay_code(rising_us),
            falling=delay_code(falling_us),
        )

    def set_trigger_out_2(self, inverted: bool, rising_us: float) -> None:
        """Configure trigger output 2, which pulses once in a run."""
        self.link.write(protocol.TRIGGER_OUT_2, inverted=int(inverted), rising=delay_code(rising_us))

    def set_display_mode(self, mode: DisplayMode) -> None:
        """Change between video and pattern mode, and wait for the change."""
        if self._mode() == mode:
            return
        if mode is DisplayMode.VIDEO and self.is_locked():
            raise StateError(
                self._name,
                "display mode",
                "it is in pattern mode with a signal on its video port, and may freeze on leaving that mode",
                "unplug the HDMI cable, and try again; or switch the projector off and on",
            )
        if mode is DisplayMode.PATTERN:  # with a test pattern selected the USB link was lost on the way back
            self.link.write(protocol.INPUT_SOURCE, **PARALLEL_24_BIT)
        self.link.write(protocol.DISPLAY_MODE, mode=int(mode))
        self._poll_until(
            lambda: self._mode() == mode, "display mode", f"is not in {mode.name} mode", MODE_CHANGE
        )

    def select_video(self) -> None:
        """Enter pattern mode with 24-bit frames from the parallel port (HDMI), whose signal is locked."""
        # To be called before patterns from the video port are prepared. TI's GUI wants the signal locked
        # before it enters pattern mode. A board that is in this mode with a signal stays in it: users report
        # that the DLPC350 freezes on repeated changes to video mode (TI's forum, 968244).
        self.link.write(protocol.INPUT_SOURCE, **PARALLEL_24_BIT)
        self.link.write(protocol.PORT_CLOCK, clock=0)
        self.link.write(protocol.PIXEL_FORMAT, format=0)
        self.link.write(protocol.CHANNEL_SWAP, **BOARD_CHANNEL_SWAP)
        if self._mode() == DisplayMode.PATTERN:
            with suppress(DeviceTimeoutError):
                self._await_lock()
                self._reset(protocol.AREA, WHOLE_AREA)
                return
        self.set_display_mode(DisplayMode.VIDEO)
        self._await_lock()
        self._reset(protocol.AREA, WHOLE_AREA)
        self.set_display_mode(DisplayMode.PATTERN)

    def _await_lock(self) -> None:
        self._poll_until(self.is_locked, "video", "no signal is locked on the video port", LOCKING)

    def show_test_pattern(self, name: str) -> None:
        """Show an internal test pattern, white on black, lit by the LEDs at their present currents."""
        self.go_dark()
        self.set_display_mode(DisplayMode.VIDEO)
        self.link.write(protocol.INPUT_SOURCE, **INTERNAL_TEST_PATTERN)
        self.link.write(protocol.TEST_PATTERN, pattern=protocol.TEST_PATTERNS.index(name))
        white = dict.fromkeys(("front_red", "front_green", "front_blue"), 1023)  # 10 bits
        black = dict.fromkeys(("back_red", "back_green", "back_blue"), 0)
        self.link.write(protocol.TEST_PATTERN_COLOURS, **white, **black)
        self.link.write(protocol.LED_ENABLE, red=0, green=0, blue=0, sequenced=1)

    def is_locked(self) -> bool:
        return self.link.read(protocol.VIDEO_SIGNAL)["lock"] == protocol.LOCKED

    def images_in_flash(self) -> int:
        return self.link.read(protocol.IMAGES_IN_FLASH)["count"]

    def image_load_us(self, image: int) -> int:
        """Measure the load time of a flash image."""
        self.link.write(protocol.IMAGE_LOAD_TIMING, first=image, count=1)
        ticks = 0

        def measured() -> bool:
            nonlocal ticks
            ticks = self.link.read(protocol.IMAGE_LOAD_TIMING)["ticks"]
            return ticks > 0

        reason = f"the load time of image {image} still reads 0"
        self._poll_until(measured, "image load timing", reason, LOAD_TIMING)
        return -(-1000 * ticks // protocol.TICKS_PER_MS)

    def stop(self) -> None:
        """Stop the sequence and wait for it; the next start begins at its first pattern."""
        self.link.write(protocol.SEQUENCE, run=Run.STOP)
        self._poll_until(
            lambda: self.link.read(protocol.SEQUENCE)["run"] == Run.STOP,
            "stop",
            "the sequence still runs",
            STOPPING,
        )

    def _mode(self) -> int:
        return self.link.read(protocol.DISPLAY_MODE)["mode"]

    def _poll_until(self, done: Callable[[], bool], operation: str, reason: str, polling: Polling) -> None:
        """Poll until done, or raise `DeviceTimeoutError` with `reason` after the limit."""
        for _ in range(round(polling.limit_s / polling.step_s)):
            if done():
                return
            self._clock.sleep(polling.step_s)
        raise DeviceTimeoutError(
            self._name, operation, f"{reason} after {polling.limit_s:g} s", "switch it off and on"
        )
