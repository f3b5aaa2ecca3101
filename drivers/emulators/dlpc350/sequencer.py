"""The pattern sequencer: which pattern is on the mirrors at what time, and which trigger pulses go with it.

The caller gives the time. Nothing happens outside of `advance`, which does in order what was due. The pulses
of a pattern are reported when it begins, with the times of their edges.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.clock import ROUNDING_S
from drivers.dlp4500.layout import Values
from drivers.dlp4500.protocol import DELAY_STEP_US, ZERO_DELAY_CODE, PatternTrigger, Run, TriggerMode


@dataclass(frozen=True)
class Pulse:
    """A pulse on a trigger output."""

    output: int  # trigger output 1 or 2
    rise_s: float  # time of the first edge in s
    fall_s: float  # time of the second edge in s
    pattern: int  # index since the start of the pattern that caused it


@dataclass(frozen=True)
class SequenceTables:
    """What a sequence consists of."""

    mode: TriggerMode  # what starts each pattern
    entries: Sequence[Values]  # fields of the pattern table
    times: Sequence[tuple[float, float]]  # exposure and period of each entry in s
    images: Sequence[int]  # flash image indices in the order in which they are swapped in
    load_s: Sequence[float]  # load times in s by flash image index
    patterns: int  # length of a run that is not repeated, and the spacing of pulses on output 2
    repeat: bool  # whether the sequence is repeated
    edges_s: tuple[float, float, float]  # (float, float, float) s
    vsync_s: float = 0.0  # period of the video frames in s
    input_delay_s: float = 0.0  # time in s from an edge on trigger input 1 to its pattern


@dataclass(frozen=True)
class DisplayedPattern:
    """A pattern on the mirrors."""

    entry: Values  # its entry in the pattern table
    image: int  # index of the image it is taken from
    begin_s: float  # time in s when it began
    illuminated_until_s: float  # time in s when its exposure ends

    def plane_ends_s(self) -> list[float]:
        """Return when each bit plane ends, if all are shown once, the least significant first."""
        depth = self.entry["depth"]
        whole_s = self.illuminated_until_s - self.begin_s
        shares = [((2 << plane) - 1) / ((1 << depth) - 1) for plane in range(depth)]
        return [self.begin_s + share * whole_s for share in shares]


def delay_s(code: int) -> float:
    return (code - ZERO_DELAY_CODE) * DELAY_STEP_US * 1e-6


def per_pattern_times(
    entries: Sequence[Values], times: Sequence[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Divide the exposure of each trigger pulse among the patterns that share it."""
    # times (float, float) s; returns (float, float) s
    starts = [i for i, entry in enumerate(entries) if not (entry["share_trigger"] and i)]
    pattern_times: list[tuple[float, float]] = []
    for start, end in zip(starts, [*starts[1:], len(entries)], strict=True):
        count, (exposure, period) = end - start, times[start]
        pattern_times += [(exposure / count, exposure / count)] * (count - 1)
        pattern_times.append((exposure / count, period - exposure * (count - 1) / count))
    return pattern_times


class Sequencer:
    """Runs one sequence at a time."""

    def __init__(
        self, on_pulse: Callable[[Pulse], None], on_frame: Callable[[float], None] = lambda at_s: None
    ) -> None:
        self._on_pulse, self._on_frame = on_pulse, on_frame
        self.state, self.running, self.forced_swap = Run.STOP, False, False
        self.shown: DisplayedPattern | None = None
        self._tables: SequenceTables | None = None
        self._next_s: float | None = None
        self._count = self._swaps = self._image = 0
        self._rewind()

    def start(self, tables: SequenceTables, now: float) -> None:
        """Start the sequence, or resume it at the pattern at which it was paused."""
        if self.state is not Run.PAUSE:
            self._rewind()
        self._tables = tables
        self._times = per_pattern_times(tables.entries, tables.times)
        self.state, self.running = Run.START, True
        self._schedule_next(now)

    def pause(self) -> None:
        """Keep the present pattern; a start then shows it again from its beginning."""
        if self.running and self._count:
            self._count -= 1
            self._swaps -= self._swaps_image(self._count)
        self.state, self.running, self._next_s = Run.PAUSE, False, None

    def stop(self) -> None:
        """Stop; a start then begins with the first pattern."""
        self.state, self.running, self._next_s = Run.STOP, False, None

    def advance(self, now: float) -> None:
        while self.running and self._next_s is not None and self._next_s <= now:
            self._show_next_pattern(self._next_s)

    @property
    def tables(self) -> SequenceTables | None:
        """The sequence that runs, or that ran last; None before the first start."""
        return self._tables

    @property
    def next_s(self) -> float | None:
        """Time in s when the next pattern begins without a trigger; None if it waits for one or stops."""
        return self._next_s if self.running else None

    def trigger_in(self, number: int, rising: bool, now: float) -> None:
        """Take an edge on a trigger input; one before the end of the present period is lost."""
        self.advance(now)
        if not self.running or self._tables is None:
            return
        edge = PatternTrigger.RISING if rising else PatternTrigger.FALLING
        if self._tables.mode is TriggerMode.ALTERNATING:
            pair, other = divmod(self._count - 1, 2)
            self._count = 2 * pair + 1 - other if number == 1 else 2 * (pair + 1)
            self._count %= len(self._tables.entries)
            self._show_next_pattern(now)
        elif number == 1 and self._next_s is None and now >= self._ready_s and self._next_trigger_is(edge):
            self._next_s = now + self._tables.input_delay_s

    def displayed_at(self, now: float, keep_last: bool) -> DisplayedPattern | None:
        shown = self.shown
        if shown is None or (not self.running and self.state is not Run.PAUSE and not keep_last):
            return None
        return shown if not self.running or now < shown.illuminated_until_s or self._seamless else None

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

    def _swaps_image(self, count: int) -> bool:
        return bool(self._entry(count)["swap"]) or count == 0

    def _next_trigger_is(self, trigger: PatternTrigger) -> bool:
        return self._entry(self._count)["trigger"] == trigger

    def _schedule_next(self, earliest_s: float) -> None:
        """Set when the next pattern begins, at the earliest at `earliest_s`."""
        tables = self._tables
        assert tables is not None
        self._ready_s = earliest_s
        ended = not tables.repeat and self._count >= tables.patterns
        if (
            ended
            or self._next_trigger_is(PatternTrigger.INTERNAL)
            or self._next_trigger_is(PatternTrigger.NONE)
        ):
            self._next_s = earliest_s
        elif tables.mode in (TriggerMode.VSYNC, TriggerMode.VSYNC_VARIABLE):
            frames = -(-(earliest_s - ROUNDING_S) // tables.vsync_s)
            self._next_s = frames * tables.vsync_s
        elif tables.mode is TriggerMode.ALTERNATING and self._count == 0:
            self._next_s = earliest_s
        else:
            self._next_s = None

    def _show_next_pattern(self, at_s: float) -> None:
        tables = self._tables
        assert tables is not None
        if not tables.repeat and self._count >= tables.patterns:
            self.stop()
            return
        entry = self._entry(self._count)
        if self._swaps_image(self._count):
            self._swap_image(tables, at_s)
        exposure, period = self._times[self._count % len(self._times)]
        image = self._image
        self.shown = DisplayedPattern(entry, image, at_s, at_s + exposure)
        self._emit_trigger_pulse(tables, at_s)
        self._count += 1
        if tables.mode is TriggerMode.ALTERNATING:
            self._next_s = None
        else:
            self._schedule_next(at_s + period)

    def _swap_image(self, tables: SequenceTables, at_s: float) -> None:
        """Take the next image; if it is not loaded yet, keep the old one and set a flag."""
        if not tables.images:  # video frames come by themselves
            self._image = self._swaps
            self._on_frame(at_s)
        else:
            image = tables.images[self._swaps % len(tables.images)]
            preloaded = len(tables.images) <= 2 or self._swaps == 0
            if preloaded or at_s - self._last_swap_s >= tables.load_s[image] - ROUNDING_S:
                self._image = image
            else:
                self.forced_swap = True
        self._swaps += 1
        self._last_swap_s = at_s

    def _emit_trigger_pulse(self, tables: SequenceTables, at_s: float) -> None:
        index, entry = self._count, self._entry(self._count)
        rise, fall, second = tables.edges_s
        if not entry["share_trigger"]:
            exposure, _ = tables.times[index % len(tables.times)]
            self._on_pulse(Pulse(1, at_s + rise, at_s + exposure + fall, index))
        if index % tables.patterns == 0:
            self._on_pulse(Pulse(2, at_s + second, at_s + second, index))
