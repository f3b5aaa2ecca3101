"""The LightCrafter 4500 as a projector of a rig, with its patterns in flash.

    projector:
      backend: "drivers.dlp4500:Dlp4500"
      flash: flash_index.yaml
      led_levels: {red: 104, green: 135, blue: 130}
      trigger_out_1: {rising_us: 0, falling_us: 0}

Proven on an emulated wire only: no board has been driven with it yet.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import Field

from drivers.clock import Clock, RealClock
from drivers.dlp4500.controller import Controller
from drivers.dlp4500.index import FlashIndex, checksum, shown_image
from drivers.dlp4500.protocol import MOST_VARIABLE_ENTRIES, Mode
from drivers.dlp4500.sequence import (
    LEAST_EXPOSURE_US,
    PRELOADED_IMAGES,
    SIZE,
    Program,
    Slot,
    flash_program,
    still,
)
from drivers.dlp4500.transport import Hid, Link, connect, hidapi
from fpplab import config
from fpplab.config import Document
from fpplab.conventions import Lattice
from fpplab.devices import DeviceInfo, Projector, ProjectorCaps
from fpplab.errors import CapabilityError, ConfigError, DeviceError, SettingError, SyncError
from fpplab.patterns import Pattern

Level = Annotated[int, Field(ge=0, le=255)]
Delay = Annotated[float, Field(ge=-20.0, le=2.7)]


class LedLevels(Document):
    """Brightness of each LED, 0 (off) to 255 (full); the board's own defaults."""

    red: Level = 104
    green: Level = 135
    blue: Level = 130


class TriggerOut(Document):
    """A trigger output; the delay of its rising edge in µs."""

    inverted: bool = False
    rising_us: Delay = 0.0


class PatternTriggerOut(TriggerOut):
    """The output that is high as long as a pattern is on: its falling edge has a delay as well."""

    falling_us: Delay = 0.0


class Options(Document):
    """The projector's section in a rig file.

    flash: the index of what is in flash. serial: where several are connected. leds: those that light the
    patterns. led_inverted: the board takes 255 for off, as the evaluation module does. checks_echo: answers
    must bear the number of their question; to be turned off for a board that does not do so.
    """

    flash: str
    serial: str | None = None
    leds: Annotated[tuple[Literal["red", "green", "blue"], ...], Field(min_length=1)] = (
        "red",
        "green",
        "blue",
    )
    led_levels: LedLevels = LedLevels()
    led_inverted: bool = True
    trigger_out_1: PatternTriggerOut = PatternTriggerOut()
    trigger_out_2: TriggerOut = TriggerOut()
    checks_echo: bool = True


class Dlp4500(Projector):
    """A LightCrafter 4500 that shows what is in its flash.

    It opens the device through hidapi, or through what the rig's bench gives as `hid` and `clock`.
    """

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        self._options = config.validate(options, Options, self.name)
        self._index = config.load(self._options.flash, FlashIndex)
        self._hid: Hid | None = getattr(bench, "hid", None)
        self._clock: Clock = getattr(bench, "clock", None) or RealClock()
        self._controller: Controller | None = None

    def _open(self) -> None:
        self._slots: list[Slot] = []
        self._load_us: dict[int, int] = {}
        self._played = self._forced_before = False
        options = self._options
        wire, self._serial = connect(self._hid or hidapi(self.name), self.name, options.serial)
        link = Link(wire, self._clock, self.name, options.checks_echo)
        self._controller = controller = Controller(link, self._clock, self.name)
        link.drain()
        if controller.is_standby():
            controller.wake()
        controller.check_health()
        controller.go_dark()
        controller.show_mode(Mode.PATTERN)
        self._check_flash(controller)
        controller.plain()
        controller.set_led_levels(options.led_levels.model_dump(), options.led_inverted)
        first, second = options.trigger_out_1, options.trigger_out_2
        controller.set_trigger_out_1(first.inverted, first.rising_us, first.falling_us)
        controller.set_trigger_out_2(second.inverted, second.rising_us)

    def _close(self) -> None:
        controller, self._controller = self._controller, None
        if controller is None:
            return
        try:
            controller.go_dark()
        finally:
            controller.link.close()

    def _info(self) -> DeviceInfo:
        with self._dark_on_failure() as board:
            model = f"DLP LightCrafter 4500, firmware {board.version()} {board.tag()}"
        return DeviceInfo("projector", model.strip(), self._serial, "USB HID")

    def _caps(self) -> ProjectorCaps:
        depths = {bits: LEAST_EXPOSURE_US[bits] * 1e-6 for bits in sorted(self._index.depths)}
        return ProjectorCaps(SIZE, Lattice.DIAMOND, depths, 2, MOST_VARIABLE_ENTRIES)

    def _load(self, patterns: Sequence[Pattern]) -> Sequence[Pattern]:
        shown = [replace(pattern, image=shown_image(pattern)) for pattern in patterns]
        slots = [self._find(pattern) for pattern in shown]
        changes = 1 + sum(a.image != b.image for a, b in pairwise(slots))
        if changes > PRELOADED_IMAGES:
            with self._dark_on_failure() as board:
                for image in {slot.image for slot in slots} - set(self._load_us):
                    self._load_us[image] = board.load_us(image)
        self._program(slots, max(LEAST_EXPOSURE_US[slot.bits] for slot in slots))
        self._slots = slots
        return shown

    def _show(self, i: int) -> None:
        slot = self._slots[i]
        with self._dark_on_failure() as board:
            self._run(board, still(slot, LEAST_EXPOSURE_US[slot.bits], self._options.leds))

    def _play(self, exposure_s: float) -> None:
        program = self._program(self._slots, round(exposure_s * 1e6))
        with self._dark_on_failure() as board:
            self._forced_before = board.has_forced_swap()
            self._run(board, program)
        self._played = True

    def _blank(self) -> None:
        self._board.go_dark()
        played, self._played = self._played, False
        if played and not self._forced_before and self._board.has_forced_swap():
            raise SyncError(
                self.name,
                "play",
                "an image was not loaded in time, and an old one was shown in its place",
                "expose longer, or put the patterns into fewer images",
            )

    @property
    def _board(self) -> Controller:
        assert self._controller is not None, "hooks are called on an open device"
        return self._controller

    @contextmanager
    def _dark_on_failure(self) -> Iterator[Controller]:
        """The controller, to talk to; a failure leaves the projector dark at once."""
        try:
            yield self._board
        except BaseException as error:
            try:
                self._board.go_dark()
            except DeviceError as still_lit:
                error.add_note(f"and it could not be made dark: {still_lit}")
            raise

    @staticmethod
    def _run(board: Controller, program: Program) -> None:
        """No light but from the start on: should the cable be lost before, nobody could put it out."""
        board.leds_off()
        board.prepare(program)
        board.start(program)

    def _program(self, slots: Sequence[Slot], exposure_us: int) -> Program:
        try:
            return flash_program(slots, exposure_us, self._options.leds, load_us=self._load_us)
        except ValueError as error:
            raise SettingError(self.name, "load", str(error), "change the plan") from error

    def _find(self, pattern: Pattern) -> Slot:
        found = self._index.find(pattern.id, pattern.bit_depth, checksum(pattern.image))
        if found is None:
            raise CapabilityError(
                self.name,
                "load",
                f"the flash does not hold pattern {pattern.id}, {pattern.bit_depth} bits, as it is planned",
                "build the plan's image and upload it",
            )
        return found.slot

    def _check_flash(self, controller: Controller) -> None:
        """The index must not name images that the flash has not; the count cannot tell 256 from 0."""
        count = controller.images_in_flash() or 256
        last = max(pattern.image for pattern in self._index.patterns)
        if last >= count:
            raise ConfigError(
                f"{self._options.flash}: 'image' is {last}: the projector has images 0 to {count - 1}"
            )
