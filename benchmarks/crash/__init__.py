"""Commands killed, interrupted and started twice, at random moments, beside the same commands undisturbed.

`python -m benchmarks.crash` ends 200 runs by SIGKILL and 200 by SIGINT, SIGTERM or SIGHUP, and starts two and
four processes into one folder 50 times, with and without `--force`. It takes an hour; an interrupted run is
gone on with. Every figure is a number of failures, and its baseline 0; but for the runs that a signal ended
before the program's first line or after its answer, which may be all of those that got one.
"""

import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks import Result, below
from benchmarks.crash import contests, kills, signals
from benchmarks.crash.programs import PROGRAMS, SCAN, DisturbedProgram, prepare
from benchmarks.crash.record import Campaign, CrashRecord


@dataclass(frozen=True)
class CrashPart:
    """A part of the benchmark."""

    disturb: Callable[[Campaign], None]  # does what a campaign says
    kinds: tuple[str, ...]  # what may go wrong
    count: int  # how often programs are disturbed


PARTS = {
    kills.KILLS: CrashPart(kills.kill_programs, kills.KINDS, 200),
    signals.INTERRUPTS: CrashPart(signals.signal_programs, signals.KINDS, 200),
    contests.CONTESTS: CrashPart(contests.contest_programs, contests.KINDS, 50),
}


def run() -> list[Result]:
    """Disturb all programs."""
    with tempfile.TemporaryDirectory(prefix="fpplab-crash-record-") as place:
        return crash_figures(CrashRecord(Path(place) / "record.jsonl"))


def crash_figures(
    record: CrashRecord,
    parts: tuple[str, ...] = tuple(PARTS),
    programs: tuple[DisturbedProgram, ...] = PROGRAMS,
    count: int | None = None,
    seed: int = 1,
) -> list[Result]:
    """Disturb some programs, as far as that is not recorded and there is time."""
    with tempfile.TemporaryDirectory(prefix="fpplab-crash-") as place:
        folder = Path(place)
        prepare(folder, tuple({*programs, SCAN}) if contests.CONTESTS in parts else programs)
        for name in parts:
            times = PARTS[name].count if count is None else count
            PARTS[name].disturb(Campaign(folder, programs, times, seed, record))
    figures = []
    for name in parts:
        found = Counter(kind for case in record.of(name) for kind, _ in case.failures)
        figures += [below(kind, found[kind], "", 0) for kind in PARTS[name].kinds]
        if name == signals.INTERRUPTS:
            runs = sum(case.disturbances for case in record.of(name))
            figures += [below(kind, found[kind], "", runs) for kind in signals.NO_FAULTS]
    return figures
