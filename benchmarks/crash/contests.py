"""Two and four processes into one folder: one wins, the others say who, and nothing is damaged."""

import shutil
import time
from pathlib import Path

from benchmarks.crash.content import content_of
from benchmarks.crash.programs import SCAN, EndedRun, note_of, run_until, start
from benchmarks.crash.record import Campaign, CrashCase

CONTESTS = "contests"
KINDS = NOT_ONE, NOT_TOLD, DAMAGED = (
    "contests: not exactly one winner",
    "contests: losers that do not say who won",
    "contests: sessions damaged",
)
TOLD = "is writing into it"


def contest_programs(campaign: Campaign) -> None:
    """Start scans into one folder at once, two and four in turn, every other pair with `--force`."""
    first = len(campaign.record.of(CONTESTS))
    if first >= campaign.count or not campaign.record.has_time:
        return
    whole = campaign.folder / "contest_whole"
    run_until(SCAN, campaign.folder, whole)
    expected = content_of(whole)
    for number in range(first, campaign.count):
        if not campaign.record.has_time:
            break
        campaign.record.add(_contest(campaign.folder, number, whole, expected))
    print(f"{len(campaign.record.of(CONTESTS))} contests", flush=True)


def _contest(folder: Path, number: int, whole: Path, expected: dict[str, str]) -> CrashCase:
    count, force = (2, 4)[number % 2], bool(number // 2 % 2)
    begun, out = time.monotonic(), folder / f"contest_{number}"
    if force:
        shutil.copytree(whole, out)
    ended = _compete(folder, out, count, force)
    words = f"{count} processes{' with --force' if force else ''}, contest {number}"
    codes, failures = [one.code for one in ended], []
    if codes.count(0) != 1:
        failures.append((NOT_ONE, f"{words}: exit codes {codes}"))
    failures += [(NOT_TOLD, f"{words}: {one.err[-500:]}") for one in ended if not _is_told(one)]
    if content_of(out) != expected:
        failures.append((DAMAGED, words))
    shutil.rmtree(out)
    return CrashCase(CONTESTS, SCAN.name, number, count - 1, round(time.monotonic() - begun, 2), failures)


def _compete(folder: Path, out: Path, count: int, force: bool) -> list[EndedRun]:
    note_of(out).parent.mkdir(exist_ok=True)
    words = ("--force",) if force else ()
    processes = [start(SCAN, folder, out, *words) for _ in range(count)]
    ended = []
    for process in processes:
        said = process.communicate()
        ended.append(EndedRun(process.returncode, *said))
    return ended


def _is_told(ended: EndedRun) -> bool:
    """Whether a process won, or says who did: who came after the winner's end finds the work done."""
    return ended.code == 0 or (ended.code == 4 and TOLD in ended.err) or ended.is_done
