"""Commands killed at random moments, run again and killed again, until they come to their end.

What stands in the journals after a kill must stand there for ever, and what is there in the end must be what
an undisturbed run leaves, file by file and byte by byte, but for what says when it was made.
"""

from __future__ import annotations

import os
import shutil
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from benchmarks.crash.content import content_of
from benchmarks.crash.failures import Failures, no_failures, note_failure
from benchmarks.crash.programs import DisturbedProgram, run_until
from fpplab.core.errors import FppError
from fpplab.core.session_names import JOURNAL
from fpplab.sessions.session import Session

MOST_IN_TURN = 4
"""Kills of one output, before it may come to its end."""
CHILDREN_S = 10.0
"""How long processes that a command started may live on."""
UNREADABLE, LOST, NOT_RESUMED, DIFFERENT, LEFT_RUNNING = (
    "killed: sessions that cannot be read",
    "killed: frames lost that were acknowledged",
    "killed: runs that the same command does not complete",
    "killed: results that differ from undisturbed ones",
    "killed: processes left running",
)


@dataclass
class _Series:
    """The kills of one program."""

    program: DisturbedProgram
    folder: Path
    random: np.random.Generator
    found: Failures
    expected: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0

    def undisturbed(self) -> None:
        for name in ("warm", "whole"):
            out = self._place(name)
            ended = run_until(self.program, self.folder, out)
            if ended.code != 0:
                raise RuntimeError(f"{self.program.name} fails undisturbed: {ended.err[-2000:]}")
        self.seconds, self.expected = ended.seconds, content_of(out)

    def chain(self, number: int, most: int) -> int:
        """Kill the runs of one output so many times at most, then let it come to its end; gives the kills."""
        out, kills, known = self._place(f"killed_{number}"), 0, dict[str, str]()
        while kills < most:
            moment_s = self.random.uniform(0.0, self.seconds)
            ended = run_until(self.program, self.folder, out, moment_s, signal.SIGKILL)
            kills += ended.code == -signal.SIGKILL
            self.seconds *= 1.02 if ended.disturbed else 0.9  # the computer's load changes
            words = f"{self.program.name}, {out.name}, kill {kills} at {moment_s:.3f} s"
            known = self._look(out, known, words)
            if ended.is_done:
                break
        else:
            ended = run_until(self.program, self.folder, out)
        self._look(out, known, f"{self.program.name}, {out.name}, completed")
        if not ended.is_done:
            note_failure(self.found, NOT_RESUMED, f"{self.program.name}, {out.name}: {ended.err[-1500:]}")
        elif (content := content_of(out)) != self.expected:
            apart = sorted(n for n in {*content, *self.expected} if content.get(n) != self.expected.get(n))
            note_failure(self.found, DIFFERENT, f"{self.program.name}, {out.name} in {', '.join(apart)}")
            return kills  # its files are left to be looked at
        _remove(out)
        return kills

    def _place(self, name: str) -> Path:
        kind = self.program.name.replace(" ", "_")
        out = self.folder / f"{kind}_{name}{self.program.suffix}"
        if self.program.begin:
            self.program.begin(self.folder, out)
        return out

    def _look(self, out: Path, known: dict[str, str], words: str) -> dict[str, str]:
        """Read all sessions, and what they have acknowledged, which must hold what they had before."""
        for _ in left_running(self.folder):
            note_failure(self.found, LEFT_RUNNING, words)
        try:
            now = dict(_acknowledged(out))
        except FppError as error:
            note_failure(self.found, UNREADABLE, f"{words}: {error}")
            return known
        lost = [name for name, line in known.items() if now.get(name) != line]
        for name in lost:
            note_failure(self.found, LOST, f"{words}: {name}")
        return now


def kill_failures(folder: Path, programs: tuple[DisturbedProgram, ...], kills: int, seed: int) -> Failures:
    """Kill programs at random moments.

    Parameters
    ----------
    folder : Path
        What `prepare` filled.
    programs : tuple of DisturbedProgram
        Which; each is killed by its share.
    kills : int
        How many times in all.
    seed : int
        Of the moments.

    Returns
    -------
    dict of str to list of str
        Descriptions of what went wrong, by kind.
    """
    found = no_failures(UNREADABLE, LOST, NOT_RESUMED, DIFFERENT, LEFT_RUNNING)
    if kills == 0:
        return {}
    whole = sum(program.share for program in programs)
    for program in programs:
        series = _Series(program, folder, np.random.default_rng([seed, len(program.words)]), found)
        series.undisturbed()
        left, number = max(1, round(kills * program.share / whole)), 0
        while left > 0:
            left -= series.chain(number, min(left, MOST_IN_TURN))
            number += 1
        print(f"{program.name}: killed, {number} outputs completed", flush=True)
    return found


def _acknowledged(out: Path) -> Iterator[tuple[str, str]]:
    """Every frame that is in a journal, read and compared with its checksum, and its line."""
    for journal in sorted(out.parent.glob(f"{out.stem}*/**/{JOURNAL}")):
        if any(part.startswith(".") for part in journal.relative_to(out.parent).parts):
            continue  # a draft, which is nobody's session
        session = Session.open(journal.parent)
        for record in session.records:
            session.read(record.index)
            yield f"{journal.parent.name}/{record.index}", record.model_dump_json()


def left_running(folder: Path) -> Iterator[int]:
    """End the processes that commands have left running: they work in the folder, and this process does not.

    Parameters
    ----------
    folder : Path
        Where the commands ran.

    Yields
    ------
    int
        Number of each process that still runs after `CHILDREN_S`.
    """
    end = time.monotonic() + CHILDREN_S
    while found := [one for one in psutil.process_iter() if _works_in(one, folder)]:
        if time.monotonic() > end:
            for one in found:
                yield one.pid
                with suppress(psutil.Error):
                    one.kill()
            return
        time.sleep(0.1)


def _works_in(process: psutil.Process, folder: Path) -> bool:
    try:
        return process.pid != os.getpid() and Path(process.cwd()) == folder and process.status() != "zombie"
    except psutil.Error:
        return False


def _remove(out: Path) -> None:
    for one in out.parent.glob(f"{out.stem}*"):
        if one.is_dir():
            shutil.rmtree(one)
        else:
            one.unlink()
