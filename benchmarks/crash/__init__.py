"""Commands killed, interrupted and started twice, at random moments, beside the same commands undisturbed.

`python -m benchmarks crash` ends 200 runs by SIGKILL and 200 by SIGINT or SIGTERM, and starts two and four
processes into one folder 50 times, with and without `--force`; it takes hours. Every figure is a number of
failures, and its baseline 0.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks import Result, below
from benchmarks.crash.contests import contest_failures
from benchmarks.crash.kills import kill_failures
from benchmarks.crash.programs import PROGRAMS, DisturbedProgram, prepare
from benchmarks.crash.signals import signal_failures


@dataclass(frozen=True)
class CrashCounts:
    """How often programs are disturbed.

    Attributes
    ----------
    kills, signals : int
        Runs that are ended by SIGKILL, and by SIGINT or SIGTERM.
    contests : int
        Times that several processes are started into one folder.
    seed : int
        Of the random moments.
    """

    kills: int = 200
    signals: int = 200
    contests: int = 50
    seed: int = 1


def run() -> list[Result]:
    """Disturb all programs.

    Returns
    -------
    list of Result
        Numbers of failures, each beside 0.
    """
    return crash_figures(CrashCounts(), PROGRAMS)


def crash_figures(counts: CrashCounts, programs: tuple[DisturbedProgram, ...]) -> list[Result]:
    """Disturb some programs; each failure is described on stderr at once.

    Parameters
    ----------
    counts : CrashCounts
        How often.
    programs : tuple of DisturbedProgram
        Which.

    Returns
    -------
    list of Result
        Numbers of failures, each beside 0.
    """
    with tempfile.TemporaryDirectory(prefix="fpplab-crash-") as place:
        folder = Path(place)
        prepare(folder, programs)
        found = kill_failures(folder, programs, counts.kills, counts.seed)
        found |= signal_failures(folder, programs, counts.signals, counts.seed)
        found |= contest_failures(folder, counts.contests)
    return [below(name, len(failures), "", 0) for name, failures in found.items()]
