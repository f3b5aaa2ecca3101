"""Pattern sequences: which bit planes a pattern is, how long it must stay, and the tables that say so.

A flash image or video frame holds 24 bit planes, the eight of green, of red and of blue. A pattern is a
number of neighbouring planes. The controller keeps two images; a third one is loaded while patterns
of the second are shown, and must be there when its turn comes.

Source: TI's DLPC350 client, GUI and SDK. Nothing here has been near a board.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

from drivers.dlp4500.protocol import (
    COLOURS,
    ENTRY,
    MOST_ENTRIES,
    MOST_IMAGES,
    MOST_VARIABLE_ENTRIES,
    MOST_VARIABLE_IMAGES,
    PatternTrigger,
    Source,
    TriggerMode,
    Values,
)

SIZE = (912, 1140)
"""Mirrors, (width, height)."""

LEAST_EXPOSURE_US = {1: 235, 2: 700, 3: 1570, 4: 1700, 5: 2000, 6: 2500, 7: 4500, 8: 8333}
"""By bit depth."""
MOST_EXPOSURE_US = 200_000_000
"""The SDK's limit."""
LEAST_GAP_US = 231
"""Of a period beyond its exposure, if it is longer at all: the sources say more than, or at least, 230."""
PRELOADED_IMAGES = 2
SOLID = 24
"""Pattern number of solid black at depth 1; inverted it is white."""

_STARTS = {
    1: range(24),
    2: range(0, 24, 2),
    3: range(0, 24, 3),
    4: range(0, 24, 4),
    5: range(1, 24, 6),
    6: range(0, 24, 6),
    7: range(1, 24, 8),
    8: range(0, 24, 8),
}
"""By bit depth: the lowest plane of each pattern number."""


def pattern_numbers(depth: int) -> range:
    """The pattern numbers of a depth. Raises `ValueError` for one that there is not."""
    if depth not in _STARTS:
        raise ValueError(f"depth is {depth}: 1 to 8")
    return range(len(_STARTS[depth]))


def bit_planes(depth: int, number: int) -> range:
    """The bit planes of pattern `number`, least significant first; 0 … 7 green, 8 … 15 red, 16 … 23 blue.

    Empty for solid black. Raises `ValueError` for a depth or number that there is not.
    """
    numbered = pattern_numbers(depth)
    if depth == 1 and number == SOLID:
        return range(0)
    if number not in numbered:
        raise ValueError(f"pattern number is {number}: 0 to {len(numbered) - 1} with {depth} bits")
    start = _STARTS[depth][number]
    return range(start, start + depth)


@dataclass(frozen=True)
class Slot:
    """Where a pattern is: the image (flash index or video frame) and the pattern's number and depth in it."""

    image: int
    number: int
    bits: int = 8


@dataclass(frozen=True)
class Entry:
    """One entry of the pattern table, in the protocol's terms; `leds` are names of colours."""

    pattern: int
    depth: int
    leds: tuple[str, ...] = COLOURS
    trigger: PatternTrigger = PatternTrigger.INTERNAL
    invert: bool = False
    black_after: bool = False
    swap: bool = False
    share_trigger: bool = False

    def values(self) -> Values:
        """The fields of `protocol.ENTRY`."""
        lit = {colour: int(colour in self.leds) for colour in COLOURS}
        return lit | {
            "trigger": int(self.trigger),
            "pattern": self.pattern,
            "depth": self.depth,
            "invert": int(self.invert),
            "black_after": int(self.black_after),
            "swap": int(self.swap),
            "share_trigger": int(self.share_trigger),
        }


@dataclass(frozen=True)
class Program:
    """A sequence: the entries shown in turn, the images swapped in, and the time for each pattern.

    images: one flash index for each entry with `swap`, in the order shown; empty for the video port.
    repeat: again from the beginning until stopped, or once.
    """

    source: Source
    entries: tuple[Entry, ...]
    images: tuple[int, ...]
    exposure_us: int
    period_us: int
    repeat: bool

    @property
    def variable(self) -> bool:
        """Whether it needs the long tables of the variable-exposure modes."""
        return len(self.entries) > MOST_ENTRIES or len(self.images) > MOST_IMAGES

    @property
    def trigger_mode(self) -> TriggerMode:
        """What advances it."""
        if self.source is Source.VIDEO:
            return TriggerMode.VSYNC_VARIABLE if self.variable else TriggerMode.VSYNC
        return TriggerMode.INTERNAL_VARIABLE if self.variable else TriggerMode.INTERNAL

    @property
    def duration_s(self) -> float:
        """Of one run."""
        return len(self.entries) * self.period_us * 1e-6

    def pattern_table(self) -> bytes:
        """The entries as the mailbox takes them, 3 bytes each."""
        return b"".join(ENTRY.pack(entry.values()) for entry in self.entries)

    def image_table(self) -> bytes:
        """The images as the mailbox takes them: the device reads a table of two from its end."""
        return bytes(reversed(self.images) if len(self.images) == 2 else self.images)


def flash_program(
    slots: Sequence[Slot],
    exposure_us: int,
    leds: tuple[str, ...] = COLOURS,
    repeat: bool = False,
    load_us: Mapping[int, int] | None = None,
    dark_us: int = 0,
) -> Program:
    """Patterns from flash, shown in the order of `slots`, each with a pulse on trigger output 1.

    load_us: how long each flash image takes to load; needed as soon as more than two are swapped in. Where
    one would come too late all periods are prolonged, so that dark follows each pattern. dark_us: how much
    must follow it in any case.
    Raises `ValueError` for an exposure or number out of range.
    """
    entries: list[Entry] = []
    images: list[int] = []
    for slot in slots:
        bit_planes(slot.bits, slot.number)
        swap = not images or slot.image != images[-1]
        if swap:
            images.append(slot.image)
        entries.append(Entry(slot.number, slot.bits, leds, swap=swap))
    least = max(exposure_us + dark_us, _least_period_us(slots, load_us or {}, repeat))
    program = Program(
        Source.FLASH,
        tuple(entries),
        tuple(images),
        exposure_us,
        shortest_period_us(exposure_us, least),
        repeat,
    )
    check_sequence(program)
    return program


def video_program(
    slots: Sequence[Slot],
    exposure_us: int,
    vsync_us: int,
    leds: tuple[str, ...] = COLOURS,
    repeat: bool = False,
) -> Program:
    """Patterns from the video port; `slots` name consecutive frames by their `image`.

    The first pattern of a frame waits for the frame; the exposures of a frame must fit into `vsync_us`.
    Raises `ValueError` when they do not, or an exposure or number is out of range.
    """
    entries = []
    for _, group in groupby(slots, key=lambda slot: slot.image):
        frame = list(group)
        if len(frame) * exposure_us > vsync_us:
            raise ValueError(
                f"{len(frame)} exposures of {exposure_us} µs in a frame: at most {vsync_us} µs together"
            )
        for k, slot in enumerate(frame):
            bit_planes(slot.bits, slot.number)
            trigger = PatternTrigger.NONE if k else PatternTrigger.RISING
            entries.append(Entry(slot.number, slot.bits, leds, trigger, swap=k == 0))
    program = Program(Source.VIDEO, tuple(entries), (), exposure_us, exposure_us, repeat)
    check_sequence(program)
    return program


def shortest_period_us(exposure_us: int, least_us: int = 0) -> int:
    """The shortest period for an exposure: as long as it, or longer by more than 230 µs."""
    return exposure_us if least_us <= exposure_us else max(least_us, exposure_us + LEAST_GAP_US)


def check_sequence(program: Program) -> None:
    """Raise `ValueError` for what the controller cannot show as it is meant."""
    entries, exposure, period = program.entries, program.exposure_us, program.period_us
    if not 1 <= len(entries) <= MOST_VARIABLE_ENTRIES:
        raise ValueError(f"{len(entries)} patterns: 1 to {MOST_VARIABLE_ENTRIES}")
    if len(program.images) > MOST_VARIABLE_IMAGES:
        raise ValueError(f"{len(program.images)} changes of image: at most {MOST_VARIABLE_IMAGES}")
    if entries[0].trigger is PatternTrigger.NONE or not entries[0].swap:
        raise ValueError("the first pattern needs a trigger and a new image")
    least = max(LEAST_EXPOSURE_US[entry.depth] for entry in entries)
    if not least <= exposure <= MOST_EXPOSURE_US:
        raise ValueError(f"the exposure is {exposure} µs: {least} to {MOST_EXPOSURE_US} µs")
    if period != exposure and period < exposure + LEAST_GAP_US:
        raise ValueError(
            f"the period is {period} µs: {exposure}, the exposure, or at least {exposure + LEAST_GAP_US} µs"
        )
    for before, entry in pairwise(entries):
        if entry.share_trigger and before.black_after:
            raise ValueError("trigger output 1 cannot stay high over inserted black")
    _check_shared(entries, exposure)


def _check_shared(entries: Sequence[Entry], exposure_us: int) -> None:
    """Patterns that share one pulse share one exposure."""
    starts = [i for i, entry in enumerate(entries) if not entry.share_trigger]
    for start, end in zip(starts, [*starts[1:], len(entries)], strict=True):
        group = entries[start:end]
        least = max(LEAST_EXPOSURE_US[entry.depth] for entry in group)
        if exposure_us < least * len(group):
            raise ValueError(
                f"{len(group)} patterns share {exposure_us} µs: at least {least * len(group)} µs"
            )


def _least_period_us(slots: Sequence[Slot], load_us: Mapping[int, int], repeat: bool) -> int:
    """How long each pattern must take for every image to be there when it is swapped in."""
    shown = [(image, len(list(group))) for image, group in groupby(slot.image for slot in slots)]
    if len(shown) <= PRELOADED_IMAGES:
        return 0
    following = [*shown[1:], shown[0]] if repeat else shown[1:]
    waits = [-(-load_us[image] // count) for (_, count), (image, _) in zip(shown, following, strict=False)]
    return max(waits)


def still_program(slot: Slot, exposure_us: int, leds: tuple[str, ...] = COLOURS) -> Program:
    """One pattern, on show until it is stopped."""
    return flash_program([slot], exposure_us, leds, repeat=True)
