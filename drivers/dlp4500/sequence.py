"""Pattern sequences: bit planes, exposure limits, and the controller's pattern and image tables.

A flash image or video frame holds 24 bit planes, eight each of green, red and blue. A pattern consists of
adjacent bit planes. The controller buffers two images; a third one is loaded while patterns of the second
are shown, and loading must be complete when its first pattern is due.

Source: TI's DLPC350 client, GUI and SDK. Not yet tested on a board.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

from drivers.dlp4500.layout import Values
from drivers.dlp4500.protocol import (
    COLOURS,
    ENTRY,
    MAX_ENTRIES,
    MAX_IMAGES,
    MAX_VARIABLE_ENTRIES,
    MAX_VARIABLE_IMAGES,
    PatternTrigger,
    Source,
    TriggerMode,
)

SIZE = (912, 1140)  # number of micromirrors (width, height)

MIN_EXPOSURE_US = {1: 235, 2: 700, 3: 1570, 4: 1700, 5: 2000, 6: 2500, 7: 4500, 8: 8333}
"""Shortest exposure in µs by bit depth, as in TI's GUI and SDK."""
MAX_EXPOSURE_US = 200_000_000  # longest exposure in µs, the limit of TI's SDK
MIN_GAP_US = 231
"""Smallest difference in µs of a period and a shorter exposure.

TI's GUI and SDK want more than 230 µs, a comment in its client at least 230: this satisfies both.
"""
PRELOADED_IMAGES = 2  # images that the controller buffers; loading a third takes time (TI's SDK)
SOLID = 24
"""Pattern number of solid black at depth 1; inverted it is white.

So TI's SDK and two other clients use it. By a comment in TI's client 25 is white, but its code refuses that.
"""

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
"""Lowest bit plane of each pattern number, by bit depth."""


def pattern_numbers(depth: int) -> range:
    if depth not in _STARTS:
        raise ValueError(f"depth is {depth}: 1 to 8")
    return range(len(_STARTS[depth]))


def bit_planes(depth: int, number: int) -> range:
    numbered = pattern_numbers(depth)
    if depth == 1 and number == SOLID:
        return range(0)
    if number not in numbered:
        raise ValueError(f"pattern number is {number}: 0 to {len(numbered) - 1} with {depth} bits")
    start = _STARTS[depth][number]
    return range(start, start + depth)


@dataclass(frozen=True)
class Slot:
    """Location of a pattern in flash or in the video frames."""

    image: int  # index of the flash image or of the video frame
    number: int  # pattern number within it
    bits: int = 8  # bit depth
    led: str | None = None  # colour of the one LED that lights it; None for all that are used

    def lit(self, leds: tuple[str, ...]) -> tuple[str, ...]:
        return leds if self.led is None else (self.led,)


@dataclass(frozen=True)
class Entry:
    """One entry of the pattern table, in the terms of the protocol."""

    pattern: int  # pattern number within the image
    depth: int  # bit depth
    leds: tuple[str, ...] = COLOURS  # colours of the LEDs that are on
    trigger: PatternTrigger = PatternTrigger.INTERNAL  # what starts the pattern
    invert: bool = False  # whether the pattern is inverted
    black_after: bool = False  # whether black is inserted after the exposure
    swap: bool = False  # whether the next image is swapped in before the pattern

    def values(self) -> Values:
        lit = {colour: int(colour in self.leds) for colour in COLOURS}
        return lit | {
            "trigger": int(self.trigger),
            "pattern": self.pattern,
            "depth": self.depth,
            "invert": int(self.invert),
            "black_after": int(self.black_after),
            "swap": int(self.swap),
            "share_trigger": 0,  # every pattern has a trigger of its own
        }


@dataclass(frozen=True)
class Program:
    """A pattern sequence with its images and timing."""

    source: Source  # flash or video port
    entries: tuple[Entry, ...]  # the patterns in the order shown
    images: tuple[int, ...]  # one flash index for each entry with `swap`, in the order shown
    exposure_us: int  # exposure of each pattern in µs
    period_us: int  # time from pattern to pattern in µs
    repeat: bool  # whether the sequence repeats until it is stopped

    @property
    def variable(self) -> bool:
        """Whether the sequence needs the longer tables of the variable-exposure modes."""
        return len(self.entries) > MAX_ENTRIES or len(self.images) > MAX_IMAGES

    @property
    def trigger_mode(self) -> TriggerMode:
        """What starts the next pattern."""
        if self.source is Source.VIDEO:
            return TriggerMode.VSYNC_VARIABLE if self.variable else TriggerMode.VSYNC
        return TriggerMode.INTERNAL_VARIABLE if self.variable else TriggerMode.INTERNAL

    @property
    def duration_s(self) -> float:
        return len(self.entries) * self.period_us * 1e-6

    def pattern_table(self) -> bytes:
        return b"".join(ENTRY.pack(entry.values()) for entry in self.entries)

    def image_table(self) -> bytes:
        # The controller reads a table of exactly two entries in reverse: TI's client swaps them when it
        # writes them, and TI's GUI swaps them back when it reads them.
        return bytes(reversed(self.images) if len(self.images) == 2 else self.images)


def flash_program(
    slots: Sequence[Slot],
    exposure_us: int,
    leds: tuple[str, ...] = COLOURS,
    repeat: bool = False,
    load_us: Mapping[int, int] | None = None,
    dark_us: int = 0,
    period_us: int = 0,
    trigger: PatternTrigger = PatternTrigger.INTERNAL,
) -> Program:
    """Build a sequence of patterns in flash, each with a pulse on trigger output 1."""
    # Where an image would be loaded too late, all periods are extended, so that dark time follows each
    # pattern.
    entries: list[Entry] = []
    images: list[int] = []
    for slot in slots:
        bit_planes(slot.bits, slot.number)
        swap = not images or slot.image != images[-1]
        if swap:
            images.append(slot.image)
        waits = trigger is not PatternTrigger.INTERNAL  # for which a pattern must end in black
        entries.append(Entry(slot.number, slot.bits, slot.lit(leds), trigger, black_after=waits, swap=swap))
    minimum = max(exposure_us + dark_us, period_us, min_period_us(slots, load_us or {}, repeat))
    program = Program(
        Source.FLASH,
        tuple(entries),
        tuple(images),
        exposure_us,
        shortest_period_us(exposure_us, minimum),
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
    """Build a sequence of patterns from the video port. The first pattern of a frame waits for the frame."""
    entries = []
    for _, group in groupby(slots, key=lambda slot: slot.image):
        frame = list(group)
        if len(frame) * exposure_us > vsync_us:
            raise ValueError(
                f"{len(frame)} exposures of {exposure_us} µs in a frame: at most {vsync_us} µs together"
            )
        for k, slot in enumerate(frame):
            bit_planes(slot.bits, slot.number)
            # As TI's GUI sets them: the frame starts the first pattern, which starts the others.
            trigger = PatternTrigger.NONE if k else PatternTrigger.RISING
            entries.append(Entry(slot.number, slot.bits, slot.lit(leds), trigger, swap=k == 0))
    program = Program(Source.VIDEO, tuple(entries), (), exposure_us, exposure_us, repeat)
    check_sequence(program)
    return program


def shortest_period_us(exposure_us: int, min_us: int = 0) -> int:
    return exposure_us if min_us <= exposure_us else max(min_us, exposure_us + MIN_GAP_US)


def check_sequence(program: Program) -> None:
    entries, exposure, period = program.entries, program.exposure_us, program.period_us
    if not 1 <= len(entries) <= MAX_VARIABLE_ENTRIES:
        raise ValueError(f"{len(entries)} patterns: 1 to {MAX_VARIABLE_ENTRIES}")
    if len(program.images) > MAX_VARIABLE_IMAGES:
        raise ValueError(f"{len(program.images)} changes of image: at most {MAX_VARIABLE_IMAGES}")
    if entries[0].trigger is PatternTrigger.NONE or not entries[0].swap:
        raise ValueError("the first pattern needs a trigger and a new image")
    minimum = max(MIN_EXPOSURE_US[entry.depth] for entry in entries)
    if not minimum <= exposure <= MAX_EXPOSURE_US:
        raise ValueError(f"the exposure is {exposure} µs: {minimum} to {MAX_EXPOSURE_US} µs")
    if period != exposure and period < exposure + MIN_GAP_US:
        raise ValueError(
            f"the period is {period} µs: {exposure}, the exposure, or at least {exposure + MIN_GAP_US} µs"
        )


def min_period_us(slots: Sequence[Slot], load_us: Mapping[int, int], repeat: bool = False) -> int:
    """Compute the shortest period at which every image is loaded when it is swapped in."""
    shown = [(image, len(list(group))) for image, group in groupby(slot.image for slot in slots)]
    if len(shown) <= PRELOADED_IMAGES:
        return 0
    following = [*shown[1:], shown[0]] if repeat else shown[1:]
    waits = [-(-load_us[image] // count) for (_, count), (image, _) in zip(shown, following, strict=False)]
    return max(waits)


def still_program(slot: Slot, exposure_us: int, leds: tuple[str, ...] = COLOURS) -> Program:
    """Build a sequence that shows one pattern until it is stopped."""
    return flash_program([slot], exposure_us, leds, repeat=True)
