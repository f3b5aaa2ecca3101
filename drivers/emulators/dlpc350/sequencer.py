"""The sequencer: which pattern is on the mirrors at what time, and which pulses leave with it.

Time is whatever the caller says; nothing happens but in `advance`, which does in order what was due. The
pulses of a pattern are told when it begins, with the times of their edges.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.dlp4500.protocol import DELAY_STEP_US, ZERO_DELAY, PatternTrigger, Run, TriggerMode, Values

LEAD_S = 1e-9
"""A frame or an image that is awaited this much too early, by rounding alone, is there."""


@dataclass(frozen=True)
class Pulse:
    """A pulse on trigger output 1 or 2, with the pattern (index since the start) that caused it."""

    output: int
    rise_s: float
    fall_s: float
    pattern: int


@dataclass(frozen=True)
class Tables:
    """What a sequence runs by.

    entries: fields of the pattern table. times: exposure and period of each in s. images: in the order in
    which they are swapped in. load_s: by flash index. patterns: length of a run that is not repeated, and the
    distance of pulses on output 2. edges_s: delays of output 1's two edges and of output 2's one. vsync_s:
    period of the video frames. input_delay_s: between an edge on trigger input 1 and its pattern.
    """

    mode: TriggerMode
    entries: Sequence[Values]
    times: Sequence[tuple[float, float]]
    images: Sequence[int]
    load_s: Sequence[float]
    patterns: int
    repeat: bool
    edges_s: tuple[float, float, float]
    vsync_s: float = 0.0
    input_delay_s: float = 0.0


@dataclass(frozen=True)
class Shown:
    """A pattern on the mirrors: its table entry, the image it is taken from, and until when it is lit."""

    entry: Values
    image: int
    begin_s: float
    lit_until_s: float


def delay_s(code: int) -> float:
    """What a trigger delay on the wire means."""
    return (code - ZERO_DELAY) * DELAY_STEP_US * 1e-6


def divided(entries: Sequence[Values], times: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Exposure and time to the next pattern of each entry: those that share a pulse share its exposure."""
    starts = [i for i, entry in enumerate(entries) if not (entry["share_trigger"] and i)]
    found: list[tuple[float, float]] = []
    for start, end in zip(starts, [*starts[1:], len(entries)], strict=True):
        count, (exposure, period) = end - start, times[start]
        found += [(exposure / count, exposure / count)] * (count - 1)
        found.append((exposure / count, period - exposure * (count - 1) / count))
    return found


class Sequencer:
    """Runs one set of tables. on_pulse: told of every pulse. on_frame: told when a video frame is taken.

    state: what was ordered last. running: whether patterns really follow each other. forced_swap: an image
    was not loaded when its turn came, and the old one was shown.
    """

    def __init__(
        self, on_pulse: Callable[[Pulse], None], on_frame: Callable[[float], None] = lambda at_s: None
    ) -> None:
        self._on_pulse, self._on_frame = on_pulse, on_frame
        self.state, self.running, self.forced_swap = Run.STOP, False, False
        self.shown: Shown | None = None
        self._tables: Tables | None = None
        self._next_s: float | None = None
        self._count = self._swaps = self._image = 0
        self._rewind()

    def start(self, tables: Tables, now: float) -> None:
        """Begin, or go on with the pattern at which it was paused."""
        if self.state is not Run.PAUSE:
            self._rewind()
        self._tables = tables
        self._times = divided(tables.entries, tables.times)
        self.state, self.running = Run.START, True
        self._await(now)

    def pause(self) -> None:
        """Keep the present pattern; a start shows it again from its beginning."""
        if self.running and self._count:
            self._count -= 1
            self._swaps -= self._is_swap(self._count)
        self.state, self.running, self._next_s = Run.PAUSE, False, None

    def stop(self) -> None:
        """Back to the first pattern."""
        self.state, self.running, self._next_s = Run.STOP, False, None

    def advance(self, now: float) -> None:
        """Do what was due until now."""
        while self.running and self._next_s is not None and self._next_s <= now:
            self._step(self._next_s)

    @property
    def tables(self) -> Tables | None:
        """What it runs by, or ran by last; None before the first start."""
        return self._tables

    @property
    def next_s(self) -> float | None:
        """When something will happen by itself; None when it waits for a trigger, or does not run."""
        return self._next_s if self.running else None

    def trigger_in(self, number: int, rising: bool, now: float) -> None:
        """An edge on trigger input 1 or 2; one that comes before the present period is over is lost."""
        self.advance(now)
        if not self.running or self._tables is None:
            return
        edge = PatternTrigger.RISING if rising else PatternTrigger.FALLING
        if self._tables.mode is TriggerMode.ALTERNATING:
            pair, other = divmod(self._count - 1, 2)
            self._count = 2 * pair + 1 - other if number == 1 else 2 * (pair + 1)
            self._count %= len(self._tables.entries)
            self._step(now)
        elif number == 1 and self._next_s is None and now >= self._ready_s and self._awaits(edge):
            self._next_s = now + self._tables.input_delay_s

    def lit(self, now: float, keeps: bool) -> Shown | None:
        """What is on the mirrors; `keeps` says whether the last pattern stays when nothing runs."""
        shown = self.shown
        if shown is None or (not self.running and self.state is not Run.PAUSE and not keeps):
            return None
        return shown if not self.running or now < shown.lit_until_s or self._seamless else None

    @property
    def _seamless(self) -> bool:
        """Whether the present pattern stays until the next one begins."""
        exposure, period = self._times[(self._count - 1) % len(self._times)]
        return bool(exposure >= period)

    def _rewind(self) -> None:
        self._count = self._swaps = 0
        self._last_swap_s = self._ready_s = 0.0
        self._next_s = None

    def _entry(self, count: int) -> Values:
        assert self._tables is not None
        return self._tables.entries[count % len(self._tables.entries)]

    def _is_swap(self, count: int) -> bool:
        return bool(self._entry(count)["swap"]) or count == 0

    def _awaits(self, trigger: PatternTrigger) -> bool:
        return self._entry(self._count)["trigger"] == trigger

    def _await(self, earliest_s: float) -> None:
        """Set when the next pattern begins."""
        tables = self._tables
        assert tables is not None
        self._ready_s = earliest_s
        ended = not tables.repeat and self._count >= tables.patterns
        if ended or self._awaits(PatternTrigger.INTERNAL) or self._awaits(PatternTrigger.NONE):
            self._next_s = earliest_s
        elif tables.mode in (TriggerMode.VSYNC, TriggerMode.VSYNC_VARIABLE):
            frames = -(-(earliest_s - LEAD_S) // tables.vsync_s)
            self._next_s = frames * tables.vsync_s
        elif tables.mode is TriggerMode.ALTERNATING and self._count == 0:
            self._next_s = earliest_s
        else:
            self._next_s = None

    def _step(self, at_s: float) -> None:
        tables = self._tables
        assert tables is not None
        if not tables.repeat and self._count >= tables.patterns:
            self.stop()
            return
        entry = self._entry(self._count)
        if self._is_swap(self._count):
            self._swap(tables, at_s)
        exposure, period = self._times[self._count % len(self._times)]
        image = self._image
        self.shown = Shown(entry, image, at_s, at_s + exposure)
        self._pulse(tables, at_s)
        self._count += 1
        if tables.mode is TriggerMode.ALTERNATING:
            self._next_s = None
        else:
            self._await(at_s + period)

    def _swap(self, tables: Tables, at_s: float) -> None:
        """Take the next image, unless it is not loaded: then the old one stays and a flag is set."""
        if not tables.images:  # video frames come by themselves
            self._image = self._swaps
            self._on_frame(at_s)
        else:
            image = tables.images[self._swaps % len(tables.images)]
            preloaded = len(tables.images) <= 2 or self._swaps == 0
            if preloaded or at_s - self._last_swap_s >= tables.load_s[image] - LEAD_S:
                self._image = image
            else:
                self.forced_swap = True
        self._swaps += 1
        self._last_swap_s = at_s

    def _pulse(self, tables: Tables, at_s: float) -> None:
        index, entry = self._count, self._entry(self._count)
        rise, fall, second = tables.edges_s
        if not entry["share_trigger"]:
            exposure, _ = tables.times[index % len(tables.times)]
            self._on_pulse(Pulse(1, at_s + rise, at_s + exposure + fall, index))
        if index % tables.patterns == 0:
            self._on_pulse(Pulse(2, at_s + second, at_s + second, index))
