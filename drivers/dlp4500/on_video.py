"""Patterns that a display of the computer sends to the projector's video port.

The display holds one frame, and the projector takes the patterns from it. Neither has to keep up with the
other: whatever delays a frame, no pattern is shown in place of another.
"""

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from drivers.clock import Clock
from drivers.display.window import Display
from drivers.dlp4500.controller import Controller
from drivers.dlp4500.packing import Planes, assign_slots, pack_images
from drivers.dlp4500.sequence import MIN_EXPOSURE_US, Slot, pattern_numbers, video_program
from fpplab.core.errors import CapabilityError, SettingError
from fpplab.devices import PatternLoads
from fpplab.patterns.fringes import Pattern

RGB = (1, 0, 2)  # colour plane of each channel of a video frame; planes are in the order green, red, blue
MAX_PATTERNS_IN_FRAME = len(pattern_numbers(1))  # patterns of one bit in a frame


class OnVideo:
    """Storage of patterns in the computer's memory, sent over the video port."""

    def __init__(self, name: str, display: Display, clock: Clock, leds: tuple[str, ...]) -> None:
        self._name, self._display, self._clock, self._leds = name, display, clock, leds
        self._patterns: Sequence[Pattern] = ()
        self._slots: list[Slot] = []
        self._displayed_image: int | None = None
        """The frame that the display holds."""

    @property
    def depths(self) -> set[int]:
        """Bit depths of which at least one pattern fits into a frame."""
        return {bits for bits, min_us in MIN_EXPOSURE_US.items() if min_us <= self._frame_us}

    @property
    def longest_us(self) -> int:
        return self._frame_us

    @property
    def gap_us(self) -> int:
        return 0

    @property
    def dark_between(self) -> bool:
        return False

    @property
    def loads(self) -> PatternLoads:
        """Frames that carry the patterns; each is sent when it is due, so that none is waited for."""
        return PatternLoads(len({slot.image for slot in self._slots}))

    @property
    def still_us(self) -> int:
        return self._frame_us

    def open(self, board: Controller) -> None:
        """Open the display, and have the projector synchronise to its signal before pattern mode."""
        self._display.open()
        board.select_video()
        self.load(board, ())

    def close(self) -> None:
        self._display.close()

    def load(self, board: Controller, patterns: Sequence[Pattern]) -> None:
        self._patterns = patterns
        self._slots = assign_slots(patterns, MAX_PATTERNS_IN_FRAME)
        self._displayed_image = None

    def show(self, board: Controller, i: int) -> None:
        """Show one pattern in every frame, for the whole frame."""
        slot = self._slots[i]
        program = video_program([slot], self._frame_us, self._frame_us, self._leds, repeat=True)
        with board.dark_on_failure():
            if slot.image != self._displayed_image:
                self._display_image(slot.image)
            board.run(program)
            self._clock.sleep(self._display.vsync_s)  # the pattern begins with the next frame

    def play(self, board: Controller, exposure_us: int, dark_us: int, period_us: int) -> None:
        """Show all patterns once, frame by frame, and wait for the end of each frame's patterns."""
        # Patterns of one frame follow each other at once, so each stays until the next may come. Where pulses
        # have to be farther apart than a frame lasts, every pattern has a frame of its own.
        if dark_us:
            raise CapabilityError(
                self._name,
                "play",
                "the video port has no dark time between patterns, which a global reset shutter needs",
                "use flash, or a rolling shutter",
            )
        if exposure_us > self._frame_us:
            raise SettingError(
                self._name,
                "play",
                f"the exposure is {exposure_us} µs, and frames of the video port last {self._frame_us} µs",
                "expose shorter, slow the display down, use flash, or use a stepped plan",
            )
        with board.dark_on_failure():
            board.go_dark()
            self._play_frames(board, min(max(exposure_us, period_us), self._frame_us), period_us)

    def check_played(self, board: Controller) -> None:
        """Do nothing: `play` has waited for the end of every frame."""

    @property
    def _frame_us(self) -> int:
        return int(self._display.vsync_s * 1e6)

    def _play_frames(self, board: Controller, exposure_us: int, period_us: int) -> None:
        gap_us = max(period_us - exposure_us, 0)
        slots = assign_slots(self._patterns, self._frame_us // exposure_us)
        groups = [list(group) for _, group in groupby(slots, lambda slot: slot.image)]
        self._displayed_image, prepared = None, None
        for frame, group in zip(pack_images(self._patterns, slots), groups, strict=True):
            board.leds_off()
            self._show_planes(frame)
            program = video_program(group, exposure_us, self._frame_us, self._leds)
            if program != prepared:
                board.prepare(program)
                prepared = program
            board.start_prepared(program)
            board.await_end(program)
            self._clock.sleep(gap_us * 1e-6)

    def _display_image(self, image: int) -> None:
        self._displayed_image = None
        planes = [i for i, slot in enumerate(self._slots) if slot.image == image]
        chosen = slice(planes[0], planes[-1] + 1)
        self._show_planes(next(pack_images(self._patterns[chosen], self._slots[chosen])))
        self._displayed_image = image

    def _show_planes(self, image: Planes) -> None:
        """Show an image, whose planes are green, red and blue, as a video frame."""
        self._display.show(np.ascontiguousarray(image[..., RGB]))
