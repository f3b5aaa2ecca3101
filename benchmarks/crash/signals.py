"""Commands that get SIGINT, SIGTERM or SIGHUP at random moments from their first millisecond on."""

import json
import re
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmarks.crash.bench import bench_is_safe
from benchmarks.crash.kills import left_running
from benchmarks.crash.programs import DisturbedProgram, EndedRun, note_of, place_of, run_until
from benchmarks.crash.record import Campaign, CrashCase
from fpplab.core.interrupts import SIGNALS

INTERRUPTS = "signals"
KINDS = WRONG_CODE, TRACEBACK, UNSAFE, LEFT_RUNNING, EARLY_TRACE = (
    "signals: exit codes other than 130",
    "signals: tracebacks",
    "signals: benches not left safe",
    "signals: processes left running",
    "signals: traces of a run that ended before the first line",
)
NO_FAULTS = BEFORE, AFTER = (
    "signals: ends before the program's first line",
    "signals: ends after the program's whole answer",
)
"""By the signal, as of any program: with no device open and nothing written, or with all closed and told,
while Python takes itself down and has no handlers any more."""
FIRST_LINE = re.compile(r'.*/fpplab/(core/)?(__(init|main)__|version)\.py", line \d+, in <module>')
ENDING_S = 0.2
"""After its last work a process is gone so soon."""
FIRST_MOMENTS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)
"""Moments in s with which every program begins."""


def signal_programs(campaign: Campaign) -> None:
    """Interrupt programs at random moments, by SIGINT, SIGTERM and SIGHUP in turn.

    Before the program's first line, and after its last, Python itself dies of the signal, as any program
    does. Such runs are counted apart: they may not have left a trace, or have to have done all.
    """
    with _heard_by_children():
        _interrupt_each(campaign)


def _interrupt_each(campaign: Campaign) -> None:
    for program, left in campaign.due(INTERRUPTS):
        seconds = run_until(program, campaign.folder, place_of(campaign.folder, program, "timed")).seconds
        first = len(campaign.record.of(INTERRUPTS, program.name))
        early = FIRST_MOMENTS[: max(1, (first + left) // 5)]
        for number in range(first, first + left):
            if not campaign.record.has_time:
                break
            random = np.random.default_rng([campaign.seed, len(program.words), number, 1])
            moment_s = early[number] if number < len(early) else random.uniform(0.0, seconds)
            signalled = SIGNALS[number % len(SIGNALS)]
            begun = time.monotonic()
            ended, failures = _interrupt(campaign.folder, program, number, moment_s, signalled)
            seconds *= 1.02 if ended.disturbed else 0.9
            took = round(time.monotonic() - begun, 2)
            campaign.record.add(CrashCase(INTERRUPTS, program.name, number, 1, took, failures))
        done = len(campaign.record.of(INTERRUPTS, program.name))
        print(f"{program.name}: interrupted {done} times", flush=True)


@contextmanager
def _heard_by_children() -> Iterator[None]:
    """Have programs hear signals that this process ignores, in the background or under `nohup`.

    They would inherit that, and fpplab leaves alone what it is told to ignore. A handler is not inherited.
    """
    ignored = [number for number in SIGNALS if signal.getsignal(number) is signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, lambda *_: None)
    try:
        yield
    finally:
        for number in ignored:
            signal.signal(number, signal.SIG_IGN)


def _interrupt(
    folder: Path, program: DisturbedProgram, number: int, moment_s: float, signalled: signal.Signals
) -> tuple[EndedRun, list[tuple[str, str]]]:
    """One run that gets a signal, and what went wrong."""
    out = place_of(folder, program, f"stopped_{number}")
    before = _files(folder)
    ended = run_until(program, folder, out, moment_s, signalled)
    words = f"{program.name}, {signalled.name} at {moment_s:.3f} s: exit code {ended.code}"
    failures = list(_complaints(ended, signalled, words, _files(folder) != before))
    if not bench_is_safe(note_of(out)):
        failures.append((UNSAFE, words))
    failures += [(LEFT_RUNNING, words) for _ in left_running(folder)]
    return ended, failures


def _files(folder: Path) -> dict[Path, tuple[int, int]]:
    """Size and time of every file, notes of the bench among them."""
    found = {path: path.stat() for path in folder.rglob("*") if path.is_file()}
    return {path: (status.st_size, status.st_mtime_ns) for path, status in found.items()}


def _complaints(
    ended: EndedRun, number: signal.Signals, words: str, wrote: bool = False
) -> Iterator[tuple[str, str]]:
    if _is_before(ended, number):
        yield BEFORE, words
        if wrote:
            yield EARLY_TRACE, words
        return
    if ended.code == -number and _has_answered(ended):
        yield AFTER, words
        return
    said = f"{words}\n{ended.err[-1500:]}"
    if ended.code != 130 and not _came_too_late(ended):
        yield WRONG_CODE, said
    if "Traceback" in ended.err:
        yield TRACEBACK, said


def _came_too_late(ended: EndedRun) -> bool:
    """Whether a run had done its work when the signal came."""
    return ended.code == 0 and (not ended.disturbed or ended.after_s < ENDING_S)


def _has_answered(ended: EndedRun) -> bool:
    """Whether stdout holds one whole answer, of a run that did its work."""
    try:
        answer = json.loads(ended.out)
    except ValueError:
        return False
    return "error" not in answer and "Traceback" not in ended.err


def _is_before(ended: EndedRun, number: signal.Signals) -> bool:
    """Whether Python was still loading itself, or the first line of the program's first module."""
    own = [line for line in ended.err.splitlines() if "/fpplab/" in line]
    if ended.code == -number:
        is_silent = not ended.out and (not ended.err or "Traceback" in ended.err)
        return is_silent and all(FIRST_LINE.fullmatch(line) for line in own)
    return "Traceback" in ended.err and ended.code == 1 and all(FIRST_LINE.fullmatch(line) for line in own)
