"""Mutation test of the suite.

    python -m tests.mutants [--each N] [--seed S] [--workers W] [--area AREA …] [--minutes M] [--remake]

Draws faults at random on the syntax of every area, beside those of `named.yaml`, tries each by the quick
tests that execute it, and fails unless 95 % are killed and every survivor is explained in `equivalent.yaml`.
Which tests execute what is recorded once, by the whole quick suite, and kept in build/mutants with every
verdict: an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import queue
import shutil
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import yaml

from tests.mutants import coverage_map
from tests.mutants.areas import AREAS, draw, named
from tests.mutants.choice import Chooser
from tests.mutants.judge import KILLED, Bench, Trial, Verdict
from tests.mutants.record import TrialRecord, test_of
from tests.mutants.seeding import Mutant
from tests.mutants.tree import ROOT, copy_tree

RECORDED = ROOT / "build" / "mutants"
EQUIVALENT = Path(__file__).with_name("equivalent.yaml")
LEAST_KILLED = 0.95


def explained() -> dict[str, str]:
    """By fault, why no test can notice it."""
    return yaml.safe_load(EQUIVALENT.read_text(encoding="utf-8")) or {}


def main(words: list[str]) -> int:
    """Draw faults, judge them, and print what became of each."""
    asked = _parser().parse_args(words)
    if asked.remake:
        shutil.rmtree(asked.map, ignore_errors=True)
    if asked.record or not (asked.map / "map.json").exists():
        coverage_map.make(asked.map, asked.record or ["tests"], asked.workers)
    by_name = named(ROOT)
    first = {mutant.name: tests for mutant, tests in by_name.items()}
    there = coverage_map.collected(["tests"])
    known = coverage_map.without_gone(coverage_map.load(asked.map), there)
    chooser = Chooser(ROOT, known, first=first)
    drawn = draw(ROOT, asked.each, asked.seed, tuple(asked.area or AREAS))
    every = [*by_name, *drawn][: asked.most]
    record = TrialRecord(asked.map / "trials.jsonl", there, 60 * asked.minutes)
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        free: queue.Queue[Bench] = queue.Queue()
        for k in range(asked.workers):
            free.put(Bench(copy_tree(Path(folder) / str(k)), chooser))

        def judge(mutant: Mutant) -> Trial | None:
            known = record.known(mutant)
            if known or not record.has_time:
                return known
            bench = free.get()
            try:
                trial = bench.try_fault(mutant)
            finally:
                free.put(bench)
            record.add(mutant, trial)
            print(f"{trial.verdict:9}  {trial.name}\n{'':11}{trial.evidence}", flush=True)
            return trial

        with ThreadPoolExecutor(asked.workers) as pool:
            judged = [(m, t) for m, t in zip(every, pool.map(judge, every), strict=True) if t]
        trials = _without_false_kills(judged, record, free.get())
    if len(trials) < len(every):
        print(f"{len(trials)} of {len(every)} are judged: the time is over, and the same command goes on.")
    return _summed_up(trials) or int(len(trials) < len(every))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--each", type=int, default=16, help="faults of each area")
    parser.add_argument("--seed", type=int, default=1, help="of the draw")
    parser.add_argument(
        "--workers", type=int, default=2, help="copies of the sources that are tested at once"
    )
    parser.add_argument("--area", action="append", choices=list(AREAS), help="only these")
    parser.add_argument("--most", type=int, help="only so many, the named ones first")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="try no fault after so long")
    parser.add_argument("--map", type=Path, default=RECORDED, help="folder of what is recorded")
    parser.add_argument(
        "--record", action="append", metavar="TESTS", help="first record tests that the map lacks"
    )
    parser.add_argument("--remake", action="store_true", help="forget what is recorded, verdicts too")
    return parser


def _without_false_kills(
    judged: list[tuple[Mutant, Trial]], record: TrialRecord, bench: Bench
) -> list[Trial]:
    """Run the tests that killed once more on the unharmed sources: one that fails there proves nothing."""
    killing = sorted({test_of(trial) for _, trial in judged} - {""} - record.passing)
    failing: set[str] = set()
    while killing and (failed := bench.run(killing, 3600)):
        test = failed.partition(" ")[2]
        # A whole file is what killed where it could not be collected.
        asked = next((one for one in killing if test == one or test.startswith(f"{one}::")), None)
        if asked is None:
            raise SystemExit(f"the tests that killed do not run on the unharmed sources: {failed}")
        failing.add(asked)
        killing = killing[killing.index(asked) + 1 :]
    trials = []
    for mutant, found in judged:
        test = test_of(found)
        why = f"{found.evidence} fails without the fault too"
        trial = Trial(found.name, Verdict.UNDECIDED, why) if test in failing else found
        if test and test not in record.passing:
            record.confirm(mutant, trial)
        trials.append(trial)
    return trials


def _summed_up(trials: list[Trial]) -> int:
    """Print the figures, and what nobody has explained; the exit code."""
    why = explained()
    count = Counter(trial.verdict for trial in trials)
    equal = [t for t in trials if t.verdict not in KILLED and t.name in why]
    left = [t for t in trials if t.verdict not in KILLED and t.name not in why]
    killed = sum(count[verdict] for verdict in KILLED)
    judged = len(trials) - len(equal)
    print(", ".join(f"{count[verdict]} {verdict}" for verdict in Verdict))
    print(f"{killed} of {judged} killed ({killed / max(judged, 1):.1%}), {len(equal)} equivalent")
    for trial in left:
        print(f"not explained: {trial.name}")
    return 0 if trials and killed >= LEAST_KILLED * judged and not left else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
