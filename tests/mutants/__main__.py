"""Mutation test of the suite.

    python -m tests.mutants [--each N] [--seed S] [--workers W] [--area AREA …] [--remake]

Draws faults at random on the syntax of every area, tries each by the quick tests that execute it, and fails
unless 95 % are killed and every survivor is explained in `equivalent.yaml`. Which tests execute what is
recorded once, by the whole quick suite, and kept in build/mutants.
"""

from __future__ import annotations

import argparse
import queue
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import yaml

from tests.mutants import coverage_map
from tests.mutants.areas import AREAS, draw
from tests.mutants.choice import Chooser
from tests.mutants.judge import KILLED, Bench, Trial, Verdict
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
    if asked.remake or not (asked.map / "map.json").exists():
        coverage_map.make(asked.map, ["tests"], asked.workers)
    chooser = Chooser(ROOT, coverage_map.load(asked.map))
    drawn = draw(ROOT, asked.each, asked.seed, tuple(asked.area or AREAS))
    wanted = set(asked.only.read_text(encoding="utf-8").splitlines()) if asked.only else None
    chosen = [mutant for mutant in drawn if wanted is None or mutant.name in wanted]
    free: queue.Queue[Bench] = queue.Queue()
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        for k in range(asked.workers):
            free.put(Bench(copy_tree(Path(folder) / str(k)), chooser))

        def judge(number: int) -> Trial:
            bench = free.get()
            try:
                trial = bench.try_fault(chosen[number])
            finally:
                free.put(bench)
            print(f"{trial.verdict:9}  {trial.name}\n{'':11}{trial.evidence}", flush=True)
            return trial

        with ThreadPoolExecutor(asked.workers) as pool:
            trials = list(pool.map(judge, range(len(chosen))))
        trials = _without_false_kills(trials, free.get())
    return _summed_up(trials)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--each", type=int, default=16, help="faults of each area")
    parser.add_argument("--seed", type=int, default=1, help="of the draw")
    parser.add_argument(
        "--workers", type=int, default=2, help="copies of the sources that are tested at once"
    )
    parser.add_argument("--area", action="append", choices=list(AREAS), help="only these")
    parser.add_argument(
        "--only", type=Path, help="a file of names, one a line: only these of the faults drawn"
    )
    parser.add_argument("--map", type=Path, default=RECORDED, help="folder of what the tests execute")
    parser.add_argument("--remake", action="store_true", help="record again what the tests execute")
    return parser


def _without_false_kills(trials: list[Trial], bench: Bench) -> list[Trial]:
    """Run the tests that killed once more on the unharmed sources: one that fails there proves nothing."""
    killing = sorted({t.evidence.partition(" ")[2] for t in trials if t.verdict is Verdict.KILLED} - {""})
    failing: set[str] = set()
    while killing and (failed := bench.run(killing, 3600)):
        test = failed.partition(" ")[2]
        if test not in killing:
            raise SystemExit(f"the tests that killed do not run on the unharmed sources: {failed}")
        failing.add(test)
        killing = [one for one in killing if one != test]
    return [
        Trial(t.name, Verdict.UNDECIDED, f"{t.evidence} fails without the fault too")
        if t.verdict is Verdict.KILLED and t.evidence.partition(" ")[2] in failing
        else t
        for t in trials
    ]


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
