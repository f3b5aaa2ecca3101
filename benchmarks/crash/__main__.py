"""`python -m benchmarks.crash`: the benchmark in parts, which goes on with what an earlier run recorded."""

import argparse
import sys
from collections import Counter
from pathlib import Path

from benchmarks.crash import PARTS, crash_figures
from benchmarks.crash.programs import PROGRAMS, ROOT
from benchmarks.crash.record import CrashRecord

RECORD = ROOT / "build" / "crash.jsonl"


def main(words: list[str]) -> int:
    """Disturb programs, and print how often each was, what a case takes, and what went wrong."""
    by_name = {program.name: program for program in PROGRAMS}
    parser = argparse.ArgumentParser(prog="python -m benchmarks.crash", description=__doc__)
    parser.add_argument("--part", action="append", choices=list(PARTS), help="only these")
    parser.add_argument("--program", action="append", choices=list(by_name), help="only these")
    parser.add_argument("--count", type=int, help="how often; by default the part's own number")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no case after so long")
    parser.add_argument(
        "--record", type=Path, default=RECORD, help="file of what is done; remove it to begin anew"
    )
    asked = parser.parse_args(words)
    record = CrashRecord(asked.record, 60 * asked.minutes)
    programs = tuple(by_name[name] for name in asked.program or by_name)
    figures = crash_figures(record, tuple(asked.part or PARTS), programs, asked.count, asked.seed)
    times: Counter[tuple[str, str]] = Counter()
    seconds: Counter[tuple[str, str]] = Counter()
    for case in record.cases:
        times[case.part, case.program] += case.disturbances
        seconds[case.part, case.program] += round(case.seconds)
    for (part, program), count in times.items():
        took = seconds[part, program]
        print(f"{part:10} {program:28} {count:4} disturbances, {took / max(count, 1):5.1f} s each")
    for figure in figures:
        print(f"{figure.name:60} {figure.value:4.0f}, at most {figure.baseline:.0f}")
    if not record.has_time:
        print("The time is over; the same command goes on.")
    return int(any(figure.value > figure.baseline for figure in figures) or not record.has_time)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
