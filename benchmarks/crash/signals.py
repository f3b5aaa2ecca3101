"""Commands that get SIGINT, SIGTERM or SIGHUP at random moments from their first millisecond on."""

from __future__ import annotations

import re
import signal
from itertools import cycle
from pathlib import Path

import numpy as np

from benchmarks.crash.bench import bench_is_safe
from benchmarks.crash.failures import Failures, note_failure
from benchmarks.crash.kills import left_running
from benchmarks.crash.programs import DisturbedProgram, EndedRun, note_of, run_until
from fpplab.core.interrupts import SIGNALS

WRONG_CODE, TRACEBACK, UNSAFE, LEFT_RUNNING, BEFORE = (
    "signals: exit codes other than 130",
    "signals: tracebacks",
    "signals: benches not left safe",
    "signals: processes left running",
    "signals: before the program's first line",
)
FIRST_LINE = re.compile(r'.*/(fpplab|benchmarks)/.*(__(init|main)__|board)\.py", line \d+, in <module>')
FIRST_MOMENTS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)
"""Moments in s with which every program begins."""


def signal_failures(
    folder: Path, programs: tuple[DisturbedProgram, ...], signals: int, seed: int
) -> Failures:
    """Interrupt programs at random moments, by SIGINT, SIGTERM and SIGHUP in turn.

    Before the program's first line Python answers itself, and nothing has begun: such runs are counted apart.

    Parameters
    ----------
    folder : Path
        What `prepare` filled.
    programs : tuple of DisturbedProgram
        Which; each is interrupted by its share.
    signals : int
        How many times in all.
    seed : int
        Of the moments.

    Returns
    -------
    dict of str to list of str
        Descriptions of what went wrong, by kind.
    """
    found: dict[str, list[str]] = {kind: [] for kind in (WRONG_CODE, TRACEBACK, UNSAFE, LEFT_RUNNING, BEFORE)}
    if signals == 0:
        return {}
    whole = sum(program.share for program in programs)
    for program in programs:
        random = np.random.default_rng([seed, len(program.words), 1])
        count = max(1, round(signals * program.share / whole))
        seconds = run_until(program, folder, _place(folder, program, "timed")).seconds
        early = list(FIRST_MOMENTS)[: max(1, count // 5)]
        for number, signalled in zip(range(count), cycle(SIGNALS), strict=False):
            out = _place(folder, program, f"stopped_{number}")
            moment_s = early[number] if number < len(early) else random.uniform(0.0, seconds)
            ended = run_until(program, folder, out, moment_s, signalled)
            seconds *= 1.02 if ended.disturbed else 0.9
            words = f"{program.name}, {signalled.name} at {moment_s:.3f} s: exit code {ended.code}"
            _judge(ended, signalled, f"{words}\n{ended.err[-1500:]}", found)
            if not bench_is_safe(note_of(out)):
                note_failure(found, UNSAFE, words)
            for _ in left_running(folder):
                note_failure(found, LEFT_RUNNING, words)
        print(f"{program.name}: interrupted {count} times", flush=True)
    return found


def _place(folder: Path, program: DisturbedProgram, name: str) -> Path:
    out = folder / f"{program.name.replace(' ', '_')}_{name}{program.suffix}"
    if program.begin:
        program.begin(folder, out)
    return out


def _judge(ended: EndedRun, number: signal.Signals, words: str, found: Failures) -> None:
    if _is_before(ended, number):
        note_failure(found, BEFORE, words.splitlines()[0])
        return
    if ended.code not in (0, 130):
        note_failure(found, WRONG_CODE, words)
    if "Traceback" in ended.err:
        note_failure(found, TRACEBACK, words)


def _is_before(ended: EndedRun, number: signal.Signals) -> bool:
    """Whether Python was still loading itself, or the first line of the program's first module."""
    own = [line for line in ended.err.splitlines() if "/fpplab/" in line or "/benchmarks/" in line]
    if ended.code == -number:
        return all(FIRST_LINE.fullmatch(line) for line in own)
    return "Traceback" in ended.err and ended.code == 1 and all(FIRST_LINE.fullmatch(line) for line in own)
