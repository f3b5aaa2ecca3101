"""The LightCrafter 4500 as a projector of a rig, with its patterns in flash or from the video port.

    projector:
      backend: "drivers.dlp4500:Dlp4500"
      flash: flash_index.yaml              # or video: {display: 1}
      led_levels: {red: 104, green: 135, blue: 130}
      trigger_out_1: {rising_us: 0, falling_us: 0}

Proven on an emulated wire only: no board has been driven with it yet.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from math import ceil
from typing import Annotated, Any, Literal, Protocol, Self

from pydantic import Field, model_validator

from drivers.clock import Clock, RealClock
from drivers.dlp4500.controller import Controller
from drivers.dlp4500.display import Display, SdlDisplay
from drivers.dlp4500.in_flash import InFlash
from drivers.dlp4500.index import shown_image
from drivers.dlp4500.on_video import OnVideo
from drivers.dlp4500.protocol import MOST_VARIABLE_ENTRIES
from drivers.dlp4500.sequence import LEAST_EXPOSURE_US, SIZE
from drivers.dlp4500.transport import HidModule, Link, connect, load_hidapi
from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Lattice
from fpplab.devices import DeviceInfo, Projector, ProjectorCaps
from fpplab.patterns.fringes import Pattern

LedLevel = Annotated[int, Field(ge=0, le=255)]
Delay = Annotated[float, Field(ge=-20.0, le=2.7)]


class LedLevels(Document):
    """Brightness of each LED, 0 (off) to 255 (full); the board's own defaults."""

    red: LedLevel = 104
    green: LedLevel = 135
    blue: LedLevel = 130


class TriggerOut(Document):
    """A trigger output; the delay of its rising edge in µs."""

    inverted: bool = False
    rising_us: Delay = 0.0


class PatternTriggerOut(TriggerOut):
    """The output that is high as long as a pattern is on: its falling edge has a delay as well."""

    falling_us: Delay = 0.0


class VideoPort(Document):
    """What is plugged into the video port. display: number or name of the computer's display."""

    display: Annotated[int, Field(ge=0)] | str


class Options(Document):
    """The projector's section in a rig file.

    flash: the index of what is in flash; video: the display that sends patterns; one of both. serial: where
    several are connected. leds: those that light the patterns. led_inverted: the board takes 255 for off, as
    the evaluation module does. checks_echo: answers must bear the number of their question; to be turned off
    for a board that does not do so.
    """

    flash: str | None = None
    video: VideoPort | None = None
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

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if self.flash is None and self.video is None:
            raise ValueError("'flash' or 'video' is missing: where the patterns are")
        if self.flash is not None and self.video is not None:
            raise ValueError("'flash' and 'video' are both there: patterns are in one of them")
        return self


class Storage(Protocol):
    """Where the patterns are, and how they get onto the mirrors."""

    @property
    def depths(self) -> set[int]:
        """The bit depths that can be shown; known once open."""

    def open(self, board: Controller) -> None:
        """Make ready, from the dark, and put the projector into pattern mode."""

    def close(self) -> None:
        """Let go of it; legal at any time, any number of times."""

    def load(self, board: Controller, patterns: Sequence[Pattern]) -> None:
        """Take patterns as they will be shown, or refuse them and keep those before."""

    def show(self, board: Controller, i: int) -> None:
        """Show one until told otherwise."""

    def play(self, board: Controller, exposure_us: int, dark_us: int) -> None:
        """Show all once, with darkness behind each; returns once that has begun, or is over."""

    def check_played(self, board: Controller) -> None:
        """After the end: raise `SyncError` unless all was shown that was to be."""


class Dlp4500(Projector):
    """A LightCrafter 4500 that shows what is in its flash, or what a display sends it.

    It opens the device through hidapi and the display through SDL, or what the rig's bench gives as `hid`,
    `display` and `clock`.
    """

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        self._options = config.validate(options, Options, self.name)
        self._hid: HidModule | None = getattr(bench, "hid", None)
        self._clock: Clock = getattr(bench, "clock", None) or RealClock()
        self._storage = self._make_storage(getattr(bench, "display", None))
        self._controller: Controller | None = None

    def _open(self) -> None:
        options = self._options
        wire, self._serial = connect(self._hid or load_hidapi(self.name), self.name, options.serial)
        link = Link(wire, self._clock, self.name, options.checks_echo)
        self._controller = controller = Controller(link, self._clock, self.name)
        link.drain()
        if controller.is_standby():
            controller.wake()
        controller.check_health()
        controller.go_dark()
        self._storage.open(controller)
        controller.reset_image_options()
        controller.set_led_levels(options.led_levels.model_dump(), options.led_inverted)
        first, second = options.trigger_out_1, options.trigger_out_2
        controller.set_trigger_out_1(first.inverted, first.rising_us, first.falling_us)
        controller.set_trigger_out_2(second.inverted, second.rising_us)

    def _close(self) -> None:
        controller, self._controller = self._controller, None
        with ExitStack() as ends:  # each whatever becomes of those before
            ends.callback(self._storage.close)
            if controller is not None:
                ends.callback(controller.link.close)
                controller.go_dark()

    def _info(self) -> DeviceInfo:
        board = self._board
        with board.dark_on_failure():
            model = f"DLP LightCrafter 4500, firmware {board.version()} {board.firmware_tag()}"
        return DeviceInfo("projector", model.strip(), self._serial, "USB HID")

    def _caps(self) -> ProjectorCaps:
        depths = {bits: LEAST_EXPOSURE_US[bits] * 1e-6 for bits in sorted(self._storage.depths)}
        return ProjectorCaps(SIZE, Lattice.DIAMOND, depths, 2, MOST_VARIABLE_ENTRIES)

    def _load(self, patterns: Sequence[Pattern]) -> Sequence[Pattern]:
        shown = [replace(pattern, image=shown_image(pattern)) for pattern in patterns]
        self._storage.load(self._board, shown)
        self._board.go_dark()  # what is still on show gives pulses: an armed camera would take them
        return shown

    def _show(self, i: int) -> None:
        self._storage.show(self._board, i)

    def _play(self, exposure_s: float, dark_s: float) -> None:
        self._storage.play(self._board, round(exposure_s * 1e6), ceil(dark_s * 1e6))

    def _blank(self) -> None:
        self._board.go_dark()
        self._storage.check_played(self._board)

    def _make_storage(self, display: Display | None) -> Storage:
        """The flash by its index, or the video port by the bench's display or the rig file's."""
        options = self._options
        if options.video is None:
            assert options.flash is not None
            return InFlash(self.name, options.flash, options.leds)
        display = display or SdlDisplay(self.name, options.video.display)
        return OnVideo(self.name, display, self._clock, options.leds)

    @property
    def _board(self) -> Controller:
        assert self._controller is not None, "hooks are called on an open device"
        return self._controller
