"""Patterns in the projector's flash."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from drivers.dlp4500.controller import Controller
from drivers.dlp4500.index import FlashIndex, index_checksum
from drivers.dlp4500.protocol import DisplayMode, PatternTrigger
from drivers.dlp4500.sequence import (
    MAX_EXPOSURE_US,
    MIN_EXPOSURE_US,
    MIN_GAP_US,
    PRELOADED_IMAGES,
    Program,
    Slot,
    flash_program,
    min_period_us,
    still_program,
)
from fpplab.core import config
from fpplab.core.errors import CapabilityError, ConfigError, SettingError, SyncError
from fpplab.devices import PatternLoads
from fpplab.patterns.fringes import Pattern

FOLLOWING_US = 500
"""Time in µs of a camera's exposure in which no pattern is shown (chosen): from its beginning to that of the
pattern, which TI does not state, and the gap that must end before the next exposure begins."""


class InFlash:
    """Storage of patterns in flash, found by an index file."""

    def __init__(self, name: str, index_file: str, leds: tuple[str, ...]) -> None:
        self._name, self._file, self._leds = name, index_file, leds
        self._index = config.load_document(index_file, FlashIndex)

    @property
    def depths(self) -> set[int]:
        return self._index.depths

    @property
    def longest_us(self) -> int:
        return MAX_EXPOSURE_US

    @property
    def gap_us(self) -> int:
        return MIN_GAP_US

    @property
    def still_us(self) -> int:
        """Time of one still pattern of the greatest depth."""
        return MIN_EXPOSURE_US[max(self.depths)]

    def open(self, board: Controller) -> None:
        """Enter pattern mode and compare the index with the number of images in flash."""
        self._slots: list[Slot] = []
        self._load_us: dict[int, int] = {}
        self._played = self._forced_before = False
        board.set_display_mode(DisplayMode.PATTERN)
        count = board.images_in_flash() or 256  # the count cannot distinguish 256 from 0
        last = max(pattern.image for pattern in self._index.patterns)
        if last >= count:
            raise ConfigError(f"{self._file}: 'image' is {last}: the projector has images 0 to {count - 1}")

    @property
    def dark_between(self) -> bool:
        """The controller inserts dark time."""
        return True

    @property
    def loads(self) -> PatternLoads:
        """Changes of image, and the time that loading takes where there are more than two."""
        changes = _changes(self._slots) if self._slots else 0
        return PatternLoads(changes, 1e-6 * min_period_us(self._slots, self._load_us))

    def close(self) -> None:
        """Do nothing: flash keeps its contents."""

    def load(self, board: Controller, patterns: Sequence[Pattern]) -> None:
        """Find each pattern in flash, and measure the load times where more than two images are needed."""
        slots = [replace(self._find(pattern), led=pattern.led) for pattern in patterns]
        if _changes(slots) > PRELOADED_IMAGES:
            board.go_dark()  # the measurement is forbidden while patterns from flash are shown
            with board.dark_on_failure():
                for image in {slot.image for slot in slots} - set(self._load_us):
                    self._load_us[image] = board.image_load_us(image)
        self._program(slots, max(MIN_EXPOSURE_US[slot.bits] for slot in slots))
        self._slots = slots

    def show(self, board: Controller, i: int) -> None:
        slot = self._slots[i]
        with board.dark_on_failure():
            board.run(still_program(slot, MIN_EXPOSURE_US[slot.bits], self._leds))

    def play(self, board: Controller, exposure_us: int, dark_us: int, period_us: int) -> None:
        """Start a run of all patterns; returns once it has begun."""
        self._start(board, self._program(self._slots, exposure_us, dark_us, period_us))

    def _start(self, board: Controller, program: Program) -> None:
        with board.dark_on_failure():
            self._forced_before = board.has_forced_swap()
            board.run(program)
        self._played = True

    def follow(self, board: Controller, pulse_us: int) -> None:
        """Show each pattern with a pulse on trigger input 1, as often as it fits, and be dark in between."""
        # A pattern is not held until a pulse ends: the controller shows it for a fixed time, after which the
        # last bit plane would stay, and takes no pulse before its period is over.
        shortest_us = max(MIN_EXPOSURE_US[slot.bits] for slot in self._slots)
        needed_us = max(shortest_us + FOLLOWING_US, min_period_us(self._slots, self._load_us))
        if pulse_us < needed_us:
            raise SettingError(
                self._name,
                "follow",
                f"exposures of {1e-3 * pulse_us:g} ms bring the patterns",
                f"at least {1e-3 * needed_us:g} ms: lengthen the plan's exposure_s",
            )
        exposure_us = (pulse_us - FOLLOWING_US) // shortest_us * shortest_us
        self._start(board, self._program(self._slots, exposure_us, MIN_GAP_US, trigger=PatternTrigger.RISING))

    def check_played(self, board: Controller) -> None:
        """Check that every image was loaded in time."""
        played, self._played = self._played, False
        if played and not self._forced_before and board.has_forced_swap():
            raise SyncError(
                self._name,
                "play",
                "an image was not loaded in time, and an older one was shown in its place",
                "expose longer, or put the patterns into fewer images",
            )

    def _program(
        self,
        slots: Sequence[Slot],
        exposure_us: int,
        dark_us: int = 0,
        period_us: int = 0,
        trigger: PatternTrigger = PatternTrigger.INTERNAL,
    ) -> Program:
        try:
            return flash_program(
                slots,
                exposure_us,
                self._leds,
                load_us=self._load_us,
                dark_us=dark_us,
                period_us=period_us,
                trigger=trigger,
            )
        except ValueError as error:
            raise SettingError(self._name, "load", str(error), "change the plan") from error

    def _find(self, pattern: Pattern) -> Slot:
        stored = self._index.find(pattern.id, pattern.bit_depth, index_checksum(pattern.image))
        if stored is None:
            raise CapabilityError(
                self._name,
                "load",
                f"the flash does not contain pattern {pattern.id}, {pattern.bit_depth} bits, of this plan",
                "build the plan's firmware file and upload it",
            )
        return stored.slot


def _changes(slots: Sequence[Slot]) -> int:
    """How often a run changes to another image, the first included."""
    return 1 + sum(a.image != b.image for a, b in pairwise(slots))
