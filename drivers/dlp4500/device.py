"""The LightCrafter 4500 as a projector of a rig, with its patterns in flash or from the video port."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from math import ceil
from typing import Annotated, Any, Literal, Protocol, Self

from pydantic import Field, model_validator

from drivers.clock import Clock, RealClock
from drivers.display.window import Display, SdlDisplay
from drivers.dlp4500.controller import Controller
from drivers.dlp4500.in_flash import InFlash
from drivers.dlp4500.index import shown_image
from drivers.dlp4500.on_video import OnVideo
from drivers.dlp4500.protocol import COLOURS, MAX_VARIABLE_ENTRIES
from drivers.dlp4500.sequence import MIN_EXPOSURE_US, SIZE
from drivers.dlp4500.transport import HidModule, Link, connect, load_hidapi
from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Lattice
from fpplab.devices import DeviceInfo, PatternLoads, Projector, ProjectorCaps
from fpplab.patterns.fringes import Pattern

LedLevel = Annotated[int, Field(ge=0, le=255)]
Delay = Annotated[float, Field(ge=-20.0, le=2.7)]


class LedLevels(Document):
    """Brightness of each LED, 0 (off) to 255 (full); by default that of the evaluation module."""

    red: LedLevel = 104
    """Level of the red LED, 0 (off) to 255 (full)."""
    green: LedLevel = 135
    """Level of the green LED, 0 (off) to 255 (full)."""
    blue: LedLevel = 130
    """Level of the blue LED, 0 (off) to 255 (full)."""


class TriggerOut(Document):
    """A trigger output."""

    inverted: bool = False
    """Whether the output is active low."""
    rising_us: Delay = 0.0
    """Delay of the rising edge in µs."""


class PatternTriggerOut(TriggerOut):
    """Trigger output 1, which is active while a pattern is shown."""

    falling_us: Delay = 0.0
    """Delay of the falling edge in µs."""


class VideoPort(Document):
    """What is connected to the projector's video port."""

    display: Annotated[int, Field(ge=0)] | str
    """Number or name of the computer's display."""


class Options(Document):
    """The projector's section in a rig file; either `flash` or `video` is needed."""

    flash: str | None = None
    """Index file of the patterns in flash, as written by `fpplab dlp4500 build`."""
    video: VideoPort | None = None
    """Display that sends the patterns to the video port."""
    serial: str | None = None
    """Serial number; needed where several projectors are connected."""
    leds: Annotated[tuple[Literal["red", "green", "blue"], ...], Field(min_length=1)] = (
        "red",
        "green",
        "blue",
    )
    """Colours of the LEDs that light the patterns."""
    led_levels: LedLevels = LedLevels()
    """Brightness of each LED."""
    led_limits: LedLevels = LedLevels(red=255, green=255, blue=255)
    """Highest level of each LED that its cooling allows; higher `led_levels` are refused."""
    led_inverted: bool = True
    """Whether the board takes 255 for off and 0 for full at normal polarity, as evaluation modules do."""
    trigger_out_1: PatternTriggerOut = PatternTriggerOut()
    """Output that is active while a pattern is shown; it triggers the camera."""
    trigger_out_2: TriggerOut = TriggerOut()
    """Output that pulses once in a run."""
    checks_echo: bool = True
    """Whether replies must carry their request's sequence number; false for a board that does not echo it."""

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if self.flash is None and self.video is None:
            raise ValueError("'flash' or 'video' is missing: the source of the patterns")
        if self.flash is not None and self.video is not None:
            raise ValueError("'flash' and 'video' are both given: name one of them")
        return self

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        for colour, limit in self.led_limits.model_dump().items():
            if (level := getattr(self.led_levels, colour)) > limit:
                raise ValueError(f"'led_levels.{colour}' is {level}, but 'led_limits.{colour}' is {limit}")
        return self


class Storage(Protocol):
    """Source of the patterns: flash or video port.

    `Dlp4500` calls these methods, with an open controller. All may raise the errors of `Controller`.
    """

    @property
    def depths(self) -> set[int]:
        """Bit depths that can be shown; known once open."""

    @property
    def longest_us(self) -> int:
        """Longest exposure in µs of a played pattern; known once open."""

    @property
    def gap_us(self) -> int:
        """Shortest time in µs to the next played pattern, where it does not follow immediately."""

    @property
    def still_us(self) -> int:
        """Time in µs after which a pattern that is shown repeats; known once open."""

    @property
    def dark_between(self) -> bool:
        """Whether it can be dark between played patterns."""

    @property
    def loads(self) -> PatternLoads:
        """Images that carry the loaded patterns, and the time that they need."""

    def open(self, board: Controller) -> None:
        """Prepare the source and enter pattern mode; the projector is dark before and after."""

    def close(self) -> None:
        """Release the source; may be called at any time, any number of times."""

    def load(self, board: Controller, patterns: Sequence[Pattern]) -> None:
        """Take the patterns, as the mirrors show them, or refuse them and keep the previous ones."""

    def show(self, board: Controller, i: int) -> None:
        """Show one pattern until the next command."""

    def play(self, board: Controller, exposure_us: int, dark_us: int, period_us: int) -> None:
        """Show all patterns once, pulses `period_us` apart at least; may return once that has begun."""

    def check_played(self, board: Controller) -> None:
        """Check after the end that all patterns were shown as intended; raise `SyncError` otherwise."""


class Dlp4500(Projector):
    """A LightCrafter 4500 that shows patterns from its flash or from a display at its video port.

    The device is opened through hidapi and the display through SDL, unless the rig's bench provides `hid`,
    `display` or `clock`.
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
        controller.reset_settings()
        controller.set_led_levels(options.led_levels.model_dump(), options.led_inverted)
        first, second = options.trigger_out_1, options.trigger_out_2
        controller.set_trigger_out_1(first.inverted, first.rising_us, first.falling_us)
        controller.set_trigger_out_2(second.inverted, second.rising_us)

    def _close(self) -> None:
        controller, self._controller = self._controller, None
        with ExitStack() as ends:  # each is tried even if the others fail
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
        depths = {bits: MIN_EXPOSURE_US[bits] * 1e-6 for bits in sorted(self._storage.depths)}
        storage = self._storage
        return ProjectorCaps(
            SIZE,
            Lattice.DIAMOND,
            depths,
            2,
            MAX_VARIABLE_ENTRIES,
            longest_s=storage.longest_us * 1e-6,
            gap_s=storage.gap_us * 1e-6,
            period_s=storage.still_us * 1e-6,
            dark_between=storage.dark_between,
            trigger_inputs=int(isinstance(storage, InFlash)),  # others take the frames of the port
            flashes=True,
            leds=COLOURS,
        )

    def _loads(self) -> PatternLoads:
        return self._storage.loads

    def _load(self, patterns: Sequence[Pattern]) -> Sequence[Pattern]:
        shown = [replace(pattern, image=shown_image(pattern)) for pattern in patterns]
        self._storage.load(self._board, shown)
        self._board.go_dark()  # a pattern still shown sends trigger pulses, which an armed camera would take
        return shown

    def _show(self, i: int) -> None:
        self._storage.show(self._board, i)

    def _play(self, exposure_s: float, dark_s: float, period_s: float) -> None:
        self._storage.play(self._board, round(exposure_s * 1e6), ceil(dark_s * 1e6), ceil(period_s * 1e6))

    def _follow(self, pulse_s: float) -> None:
        assert isinstance(self._storage, InFlash)
        self._storage.follow(self._board, int(pulse_s * 1e6))

    def _blank(self) -> None:
        self._board.go_dark()
        self._storage.check_played(self._board)

    def _make_storage(self, display: Display | None) -> Storage:
        """Create the source of the patterns: flash, or the display given by the bench or the rig file."""
        options = self._options
        if options.video is None:
            assert options.flash is not None
            return InFlash(self.name, options.flash, options.leds)
        display = display or SdlDisplay(self.name, options.video.display, SIZE)
        return OnVideo(self.name, display, self._clock, options.leds)

    @property
    def _board(self) -> Controller:
        assert self._controller is not None, "hooks are called on an open device"
        return self._controller
