"""State of the emulated controller, and the light and trigger pulses that come of it."""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from random import Random
from typing import Self, TypeVar

import numpy as np

from drivers.clock import ROUNDING_S, Clock
from drivers.display.window import VideoFrame
from drivers.dlp4500 import protocol
from drivers.dlp4500.board import NO_DELAY, WHOLE_AREA
from drivers.dlp4500.layout import Command, RegisterLayout, Values
from drivers.dlp4500.protocol import COLOURS, COMMANDS, ENTRY, MAX_ENTRIES, DisplayMode, Source, TriggerMode
from drivers.dlp4500.sequence import MIN_EXPOSURE_US, SIZE, SOLID, bit_planes
from drivers.emulators.dlpc350.light import FlashImage, ProjectedLight
from drivers.emulators.dlpc350.sequencer import DisplayedPattern, Pulse, Sequencer, delay_s
from drivers.emulators.dlpc350.video import Video, apply_area, apply_channel_swap


@dataclass(frozen=True)
class Dlpc350Policy:
    """Assumptions about the firmware."""

    echoes_sequence: bool = True  # A reply carries the sequence number of its request
    acknowledges_with_command: bool = True  # the reply to a write carries the number of its command
    answers_other_destinations: bool = False
    refuses_changes_while_running: bool = True
    needs_validation: bool = True
    validation_s: float = 0.03  # time in s that a validation takes
    stale_validations: int = 0  # how often the result of the validation before is read after a new order
    ignored_starts: int = 0  # how many orders to start are acknowledged without effect
    running_shown_late_s: float = 0.0  # how long after a start the main status still reads "stopped", in s
    turnaround_s: float = 0.0  # time in s from a request to its reply, in which the sequencer goes on
    accepts_a_gap_of_230_us: bool = False
    needs_lock_before_pattern_mode: bool = True
    # Chance that a change from pattern to video mode with a signal at the port freezes the board until its
    # power is off (TI's forum 968244: usually in under 30 changes; 0.1 freezes 96 % of boards in 30)
    freeze_chance: float = 0.0
    freeze_seed: int = 1  # of the changes that freeze it
    leds_active_low: bool = True  # at normal polarity current 255 is off, as on the evaluation module
    swap_letter_is_input: bool = True  # in a channel swap such as "CAB"
    mode_change_s: float = 0.2  # time in s that a change of the display mode takes
    wake_s: float = 2.0  # time in s that the controller takes to leave standby
    loses_wake_acknowledgement: bool = False  # the order to wake is not acknowledged
    sleeps_in_pattern_mode: bool = True  # standby is accepted in pattern mode; otherwise only in video mode
    reset_s: float = 2.0  # time in s that the USB device is absent after a software reset
    keeps_last_pattern: bool = True  # A sequence that is stopped
    # A pattern that is played for longer than its shortest exposure is stretched over it, plane after plane;
    # otherwise its planes are repeated
    stretches_patterns: bool = False
    image_load_s: float = 0.02  # time in s that loading an image from flash takes
    load_timed_s: float = 0.0  # time in s in which a load time that is being measured reads 0
    blank_identities: int = 0  # how often the boot loader reads zeros as a part of the flash's identity
    sector_erase_s: float = 0.8  # time in s that the boot loader is busy erasing a sector
    checksum_s: float = 0.001  # time in s that the boot loader is busy computing a checksum
    protects_boot_sector: bool = True  # the boot loader refuses to erase or write its own sector
    max_loader_data: int = 504  # bytes that the boot loader accepts in one data message


STRICT = Dlpc350Policy(
    ignored_starts=1,
    running_shown_late_s=0.1,
    turnaround_s=0.002,
    freeze_chance=0.1,
    stale_validations=1,
    load_timed_s=0.05,
    blank_identities=3,
)
"""The stricter case wherever no source says which one is right: tests and the emulated bench use it.

The first start after each change of a sequence has no effect, "running" is shown late, and every request
takes the time of two reports at full speed USB. Going back to video mode may freeze it, as users report. What
it measures and validates is not there at once.
"""


SEQUENCE_COMMANDS = {
    command.number
    for command in (
        protocol.PATTERN_SOURCE,
        protocol.TRIGGER_MODE,
        protocol.EXPOSURE,
        protocol.INVERT,
        protocol.PATTERN_CONFIG,
        protocol.VARIABLE_CONFIG,
        protocol.TRIGGER_OUT_1,
        protocol.TRIGGER_OUT_2,
        protocol.TRIGGER_IN_1,
        protocol.TRIGGER_IN_2,
        protocol.MAILBOX,
        protocol.MAILBOX_ADDRESS,
        protocol.MAILBOX_DATA,
        protocol.VARIABLE_ADDRESS,
        protocol.VARIABLE_DATA,
    )
}
"""Not to be changed while a sequence runs; changing any of them invalidates an earlier validation."""
ANSWERED_ASLEEP = {
    command.number
    for command in (
        protocol.HARDWARE_STATUS,
        protocol.SYSTEM_STATUS,
        protocol.MAIN_STATUS,
        protocol.VERSION,
        protocol.FIRMWARE_TAG,
        protocol.POWER,
        protocol.SOFTWARE_RESET,
    )
}
"""Commands that a controller in standby still executes."""
FIRMWARE = {"major": 4, "minor": 4, "patch": 0}
"""Version of application, API and sequencer software that the emulator reports."""
TAG = b"LCr4500 emulator"  # answer to the command for the firmware's tag
POWER_ON: dict[Command, Values] = {
    protocol.INPUT_SOURCE: {"source": 0, "width": 1},
    protocol.AREA: WHOLE_AREA,
    **dict.fromkeys(protocol.LED_DELAYS.values(), NO_DELAY),
    protocol.CHANNEL_SWAP: {"swap": 4, "port": 0},
    protocol.TRIGGER_OUT_1: {"inverted": 0, "rising": 0xBB, "falling": 0xBB},
    protocol.TRIGGER_OUT_2: {"inverted": 0, "rising": 0xBB},
    protocol.LED_CURRENT: {"red": 0x97, "green": 0x78, "blue": 0x7D},
    protocol.LED_ENABLE: {"red": 0, "green": 0, "blue": 0, "sequenced": 1},
    protocol.EXPOSURE: {"exposure_us": 500_000, "period_us": 500_000},
    protocol.PATTERN_SOURCE: {"source": Source.FLASH},
    protocol.TRIGGER_MODE: {"mode": TriggerMode.INTERNAL},
    protocol.PATTERN_CONFIG: {"entries": 3, "repeat": 1, "patterns": 3, "images": 1},
}
"""Start values of the board's configuration; a register not named here has the lowest value of each field."""


def power_on() -> dict[int, Values]:
    registers = {}
    for command in COMMANDS.values():
        if isinstance(command.written, RegisterLayout) and command.written == command.returned:
            lowest = {field.name: field.values()[0] for field in command.written.named}
            registers[command.number] = POWER_ON.get(command, lowest)
    return registers


Content = TypeVar("Content")
RegisterContents = dict[int, Content]  # table entries by their address

POWER_ON_PATTERNS = bytes.fromhex("001806 042802 084802")
"""Pattern table after power-on: three entries of 3 bytes."""
POWER_ON_IMAGES = bytes([1])  # image table after power-on: flash image 1


class PatternTables:
    """The tables as written; writing entries from an address on discards older ones from there on."""

    def __init__(self) -> None:
        self.patterns: RegisterContents[Values] = {}
        self.variable: RegisterContents[Values] = {}
        self.images: RegisterContents[int] = {}

    @classmethod
    def at_power_on(cls) -> Self:
        tables = cls()
        tables.fill_patterns(0, POWER_ON_PATTERNS)
        tables.fill_images(0, POWER_ON_IMAGES, len(POWER_ON_IMAGES))
        return tables

    def fill_patterns(self, address: int, data: bytes) -> None:
        if len(data) % 3 or address + len(data) // 3 > MAX_ENTRIES:
            raise ValueError("the entries do not fit in the pattern table")
        entries = [ENTRY.unpack(data[i : i + 3]) for i in range(0, len(data), 3)]
        _write_entries(self.patterns, address, entries)

    def fill_images(self, address: int, data: bytes, size: int) -> None:
        if address + len(data) > size:
            raise ValueError("the images do not fit in the image table")
        _write_entries(self.images, address, list(data))

    def fill_variable(self, address: int, values: Values) -> None:
        _write_entries(self.variable, address, [values])

    def entries(self, variable: bool, count: int) -> list[Values]:
        """Return the entries of a pattern table, without addresses that were not written."""
        table = self.variable if variable else self.patterns
        return [table[i] for i in range(count) if i in table]

    def images_shown(self, count: int) -> list[int]:
        """Return the image indices in the order in which the sequencer swaps them in."""
        images = [self.images[i] for i in range(count) if i in self.images]
        return images[::-1] if len(images) == 2 else images

    def pattern_bytes(self, count: int) -> bytes:
        zero = ENTRY.unpack(bytes(3))
        return b"".join(ENTRY.pack(self.patterns.get(i, zero)) for i in range(min(count, MAX_ENTRIES)))

    def image_bytes(self, count: int) -> bytes:
        return bytes(self.images.get(i, 0) for i in range(count))


def _write_entries(table: RegisterContents[Content], address: int, content: list[Content]) -> None:
    """Write entries from an address on; the table ends behind them until more is written."""
    for beyond in [i for i in table if i >= address]:
        del table[beyond]
    table |= {address + i: entry for i, entry in enumerate(content)}


def _black_image() -> FlashImage:
    return np.zeros((SIZE[1], SIZE[0], 3), np.uint8)


class LightEngine:
    """The emulated controller without its commands."""

    def __init__(
        self,
        clock: Clock,
        images: Sequence[FlashImage],
        policy: Dlpc350Policy | None = None,
        on_pulse: Callable[[Pulse], None] = lambda pulse: None,
    ) -> None:
        self.clock, self.images, self.policy = clock, images, policy or Dlpc350Policy()
        self.on_pulse = on_pulse
        self.on_restart: Callable[[float], None] = lambda seconds: None
        self.load_s = [self.policy.image_load_s] * len(images)
        self.video: Video | None = None
        self.executed: list[int] = []
        self._chances = Random(self.policy.freeze_seed)
        self.restart()

    def restart(self) -> None:
        """Start as after power-on."""
        self.frozen = False
        self.sequencer = Sequencer(self._report_pulse, self._latch_frame)
        self._frame: VideoFrame | None = None
        self._planes: tuple[VideoFrame | None, Values, Values, FlashImage] = (None, {}, {}, _black_image())
        self._was_locked = False
        self._registers = power_on()
        self.asleep, self._awake_at_s = False, 0.0
        self.mode, self._next_mode = DisplayMode.VIDEO, (DisplayMode.VIDEO, 0.0)
        self._aborted, self._unvalidated = False, True
        self._validated_s, self._ignored_starts, self._started_s = 0.0, 0, 0.0
        self._stale_reads = 0
        self._validation_result = self._last_result = dict.fromkeys(
            (field.name for field in protocol.VALIDATION.named), 0
        )
        self._timing, self._timed_s = 0, 0.0
        self._tables = PatternTables.at_power_on()

    def _report_pulse(self, pulse: Pulse) -> None:
        self.on_pulse(pulse)

    def advance(self) -> None:
        """Do everything that was due until now."""
        now = self.clock.now()
        mode, at_s = self._next_mode
        if mode is not self.mode and now >= at_s:
            self.mode = mode
        self.sequencer.advance(now)

    def light(self) -> ProjectedLight | None:
        # In video mode the content of the port is not followed: it counts as white.
        self.advance()
        return self.light_at(self.clock.now())

    def light_at(self, time_s: float) -> ProjectedLight | None:
        # It is meant for the receiver of a pulse, whose edges may lie a little ahead of the present time.
        if self.asleep:
            return None
        enabled = self._registers[protocol.LED_ENABLE.number]
        if self.mode is DisplayMode.VIDEO:
            return self._if_illuminated(
                ProjectedLight(_black_image(), 1, SOLID, True, self._levels(enabled, COLOURS), None)
            )
        shown = self.sequencer.displayed_at(time_s, self.policy.keeps_last_pattern)
        if shown is None:
            return None
        inverted = bool(shown.entry["invert"]) != bool(self._registers[protocol.INVERT.number]["on"])
        levels = self._levels(
            enabled,
            tuple(colour for colour in COLOURS if shown.entry[colour]),
            shown.illuminated_until_s - shown.begin_s,
        )
        content, entry = self._image_or_video_frame(shown.image), shown.entry
        gamma = bool(self._registers[protocol.GAMMA.number]["on"])
        depth, number = entry["depth"], entry["pattern"]
        if self._is_stretched(shown):
            ends_s = shown.plane_ends_s()
            depth, number = 1, bit_planes(depth, number)[min(bisect_right(ends_s, time_s), depth - 1)]
        return self._if_illuminated(
            ProjectedLight(content, depth, number, inverted, levels, shown.image, gamma)
        )

    def changes_s(self) -> list[float]:
        """Return when the light may change: with the next pattern, and within the present one."""
        shown = self.sequencer.shown
        planes_s = shown.plane_ends_s() if shown and self._is_stretched(shown) else []
        ends_s = [shown.illuminated_until_s] if shown else []
        return [s for s in (self.sequencer.next_s, *ends_s, *planes_s) if s is not None]

    def _is_stretched(self, shown: DisplayedPattern) -> bool:
        min_s = 1e-6 * MIN_EXPOSURE_US[shown.entry["depth"]]
        is_longer = shown.illuminated_until_s - shown.begin_s > min_s + ROUNDING_S
        return self.policy.stretches_patterns and is_longer and shown.entry["pattern"] != SOLID

    @property
    def inverts_output_1(self) -> bool:
        """Whether trigger output 1 is low while a pattern is on."""
        return bool(self._registers[protocol.TRIGGER_OUT_1.number]["inverted"])

    def trigger_in(self, number: int, rising: bool) -> None:
        """Take an edge on a trigger input, now."""
        self.sequencer.trigger_in(number, rising, self.clock.now())

    def _levels(
        self, enabled: Values, sequenced: tuple[str, ...], exposure_s: float = math.inf
    ) -> dict[str, float]:
        """Return the levels of the LEDs that are on, by their own switches or as the sequencer sets them."""
        if not enabled["sequenced"]:
            return {colour: self._led_level(colour) for colour in COLOURS if enabled[colour]}
        shares = {colour: self._led_share(colour, exposure_s) for colour in sequenced}
        return {colour: self._led_level(colour) * share for colour, share in shares.items()}

    def _led_share(self, colour: str, exposure_s: float) -> float:
        """Return the share of an exposure for which an LED is on, by the delays of its edges."""
        delays = self._registers[protocol.LED_DELAYS[colour].number]
        lit_s = delay_s(delays["falling"]) - delay_s(delays["rising"])
        return min(max(1.0 + lit_s / exposure_s, 0.0), 1.0)

    @staticmethod
    def _if_illuminated(light: ProjectedLight) -> ProjectedLight | None:
        return light if any(light.levels.values()) else None

    def _led_level(self, colour: str) -> float:
        """Return the level 0 … 1 of an LED by its current, the polarity and the board."""
        current = self._registers[protocol.LED_CURRENT.number][colour] / 255.0
        inverted = bool(self._registers[protocol.LED_POLARITY.number]["inverted"])
        return 1.0 - current if inverted != self.policy.leds_active_low else current

    def _image_or_video_frame(self, image: int) -> FlashImage:
        if self._registers[protocol.PATTERN_SOURCE.number]["source"] == Source.FLASH:
            return self.images[image] if image < len(self.images) else _black_image()
        if self._frame is None:
            return _black_image()
        swap, area = (self._registers[command.number] for command in (protocol.CHANNEL_SWAP, protocol.AREA))
        if self._planes[0] is not self._frame or self._planes[1:3] != (swap, area):
            frame = apply_channel_swap(self._frame, swap["swap"], self.policy.swap_letter_is_input)
            self._planes = (self._frame, swap, area, apply_area(frame, area))
        return self._planes[3]

    def _latch_frame(self, at_s: float) -> None:
        """Keep the frame that is on the video port, until the next one is taken."""
        self._frame = self.video.frame_at(at_s) if self.video else None

    def _is_locked(self) -> bool:
        return self.video is not None and self.video.locked
