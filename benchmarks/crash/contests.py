"""Two and four processes into one folder: one wins, the others say who, and nothing is damaged."""

from __future__ import annotations

import shutil
from pathlib import Path

from benchmarks.crash.content import content_of
from benchmarks.crash.failures import Failures, no_failures, note_failure
from benchmarks.crash.programs import SCAN, EndedRun, note_of, run_until, start

NOT_ONE, NOT_TOLD, DAMAGED = (
    "contests: not exactly one winner",
    "contests: losers that do not say who won",
    "contests: sessions damaged",
)
TOLD = "is writing into it"


def contest_failures(folder: Path, contests: int) -> Failures:
    """Start scans into one folder at once, two and four in turn, every other pair with `--force`.

    Parameters
    ----------
    folder : Path
        What `prepare` filled.
    contests : int
        How many times.

    Returns
    -------
    dict of str to list of str
        Descriptions of what went wrong, by kind.
    """
    if contests == 0:
        return {}
    found = no_failures(NOT_ONE, NOT_TOLD, DAMAGED)
    whole = folder / "contest_whole"
    run_until(SCAN, folder, whole)
    expected = content_of(whole)
    for number in range(contests):
        count, force = (2, 4)[number % 2], bool(number // 2 % 2)
        out = folder / f"contest_{number}"
        if force:
            shutil.copytree(whole, out)
        ended = _compete(folder, out, count, force)
        words = f"{count} processes{' with --force' if force else ''}, contest {number}"
        codes = [one.code for one in ended]
        if codes.count(0) != 1:
            note_failure(found, NOT_ONE, f"{words}: exit codes {codes}")
        for one in ended:
            if not _is_told(one):
                note_failure(found, NOT_TOLD, f"{words}: {one.err[-500:]}")
        if content_of(out) != expected:
            note_failure(found, DAMAGED, words)
        shutil.rmtree(out)
    print(f"{contests} contests", flush=True)
    return found


def _compete(folder: Path, out: Path, count: int, force: bool) -> list[EndedRun]:
    note_of(out).parent.mkdir(exist_ok=True)
    words = ("--force",) if force else ()
    processes = [start(SCAN, folder, out, *words) for _ in range(count)]
    ended = []
    for process in processes:
        said = process.communicate()
        ended.append(EndedRun(process.returncode, *said, disturbed=False, seconds=0.0))
    return ended


def _is_told(ended: EndedRun) -> bool:
    """Whether a process won, or says who did: who came after the winner's end finds the work done."""
    return ended.code == 0 or (ended.code == 4 and TOLD in ended.err) or ended.is_done
