"""Commands killed at random moments, run again and killed again, until they come to their end.

What stands in the journals after a kill must stand there for ever, and what is there in the end must be what
an undisturbed run leaves, file by file and byte by byte, but for what says when it was made.
"""

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
from benchmarks.crash.programs import ROOT, DisturbedProgram, place_of, run_until_killed
from benchmarks.crash.record import Campaign, CrashCase
from fpplab.core.errors import FppError
from fpplab.core.session_names import JOURNAL
from fpplab.sessions.session import Session
from tests.support.ready_program import ReadyProgram

MOST_IN_TURN = 4
"""Kills of one output, before it may come to its end."""
CHILDREN_S = 10.0
"""How long processes that a command started may live on."""
KILLS = "kills"
KINDS = UNREADABLE, LOST, NOT_RESUMED, DIFFERENT, LEFT_RUNNING = (
    "killed: sessions that cannot be read",
    "killed: frames lost that were acknowledged",
    "killed: runs that the same command does not complete",
    "killed: results that differ from undisturbed ones",
    "killed: processes left running",
)


@dataclass
class _Series:
    """The kills of one program."""

    ready: ReadyProgram
    program: DisturbedProgram
    campaign: Campaign
    expected: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    failures: list[tuple[str, str]] = field(default_factory=list)

    def undisturbed(self) -> None:
        for name in ("warm", "whole"):
            out = self._place(name)
            ended = run_until_killed(self.ready, self.program, self.campaign.folder, out)
            if ended.code != 0:
                raise RuntimeError(f"{self.program.name} fails undisturbed: {ended.err[-2000:]}")
        self.seconds, self.expected = ended.seconds, content_of(out)

    def case(self, number: int, most: int) -> CrashCase:
        """Kill the runs of one output so many times at most, then let it come to its end."""
        self.failures, begun = [], time.monotonic()
        kills = self._chain(number, most)
        seconds = round(time.monotonic() - begun, 2)
        return CrashCase(KILLS, self.program.name, number, kills, seconds, self.failures)

    def _chain(self, number: int, most: int) -> int:
        random = np.random.default_rng([self.campaign.seed, len(self.program.words), number])
        out, kills, known = self._place(f"killed_{number}"), 0, dict[str, str]()
        while kills < most:
            moment_s = random.uniform(0.0, self.seconds)
            ended = run_until_killed(self.ready, self.program, self.campaign.folder, out, moment_s)
            kills += ended.code == -signal.SIGKILL
            self.seconds *= 1.02 if ended.disturbed else 0.9  # the computer's load changes
            words = f"{self.program.name}, {out.name}, kill {kills} at {moment_s:.3f} s"
            known = self._look(out, known, words)
            if ended.is_done:
                break
        else:
            ended = run_until_killed(self.ready, self.program, self.campaign.folder, out)
        self._look(out, known, f"{self.program.name}, {out.name}, completed")
        if not ended.is_done:
            self._note(NOT_RESUMED, f"{self.program.name}, {out.name}: {ended.err[-1500:]}")
        elif (content := content_of(out)) != self.expected:
            apart = sorted(n for n in {*content, *self.expected} if content.get(n) != self.expected.get(n))
            self._note(DIFFERENT, f"{self.program.name}, {out.name} in {', '.join(apart)}")
            return kills  # its files are left to be looked at
        _remove(out)
        return kills

    def _note(self, kind: str, words: str) -> None:
        self.failures.append((kind, words))

    def _place(self, name: str) -> Path:
        return place_of(self.campaign.folder, self.program, name)

    def _look(self, out: Path, known: dict[str, str], words: str) -> dict[str, str]:
        """Read all sessions, and what they have acknowledged, which must hold what they had before."""
        for _ in left_running(self.campaign.folder):
            self._note(LEFT_RUNNING, words)
        try:
            now = dict(_acknowledged(out))
        except FppError as error:
            self._note(UNREADABLE, f"{words}: {error}")
            return known
        for name in [name for name, line in known.items() if now.get(name) != line]:
            self._note(LOST, f"{words}: {name}")
        return now


def kill_programs(campaign: Campaign) -> None:
    """Kill programs at random moments."""
    ready = ReadyProgram(ROOT)
    try:
        _kill_each(campaign, ready)
    finally:
        ready.close()


def _kill_each(campaign: Campaign, ready: ReadyProgram) -> None:
    for program, times in campaign.due(KILLS):
        series = _Series(ready, program, campaign)
        series.undisturbed()
        left, number = times, len(campaign.record.of(KILLS, program.name))
        while left > 0 and campaign.record.has_time:
            case = series.case(number, min(left, MOST_IN_TURN))
            campaign.record.add(case)
            left -= case.disturbances
            number += 1
        print(f"{program.name}: {number} outputs of killed runs completed", flush=True)


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
    """End the processes that commands left running in the folder; this process does not work there."""
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
