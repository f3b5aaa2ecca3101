"""Mutation test of the suite.

    python -m tests.mutants [listed] [drawn] [--name PART …] [--each N] [--seed S] [--area AREA …]
                            [--workers W] [--minutes M] [--remake]

Tries the faults of `faults.yaml`, each by the test that is named there, and faults drawn at random on the
syntax of every area, each by the quick tests that execute it. It fails unless 95 % are killed and every
survivor is explained in `equivalent.yaml`. Which tests execute what is recorded once, by the whole quick
suite, and kept in build/mutants with every verdict: an interrupted run goes on where it stopped. `listed`
alone needs no such recording.
"""

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
from tests.mutants.areas import AREAS, draw
from tests.mutants.choice import Chooser
from tests.mutants.fault import Fault
from tests.mutants.judge import KILLED, Bench, Trial, Verdict
from tests.mutants.listed import listed
from tests.mutants.record import TrialRecord, test_of
from tests.mutants.tree import ROOT, copy_tree

RECORDED = ROOT / "build" / "mutants"
KINDS = ("listed", "drawn")
EQUIVALENT = Path(__file__).with_name("equivalent.yaml")
MIN_KILLED = 0.95


def explained() -> dict[str, str]:
    """By fault, why no test can notice it."""
    return yaml.safe_load(EQUIVALENT.read_text(encoding="utf-8")) or {}


def main(words: list[str]) -> int:
    """Draw faults, judge them, and print what became of each."""
    parser = _parser()
    options = parser.parse_args(words)
    if unknown := set(options.kinds) - set(KINDS):
        parser.error(f"{', '.join(sorted(unknown))} is no kind of faults: {', '.join(KINDS)}")
    if options.remake:
        shutil.rmtree(options.map, ignore_errors=True)
    kinds = options.kinds or KINDS
    if options.record or ("drawn" in kinds and not (options.map / "map.json").exists()):
        coverage_map.make(options.map, options.record or ["tests"], options.workers)
    by_list = listed(ROOT) if "listed" in kinds else []
    drawn = draw(ROOT, options.each, options.seed, tuple(options.area or AREAS)) if "drawn" in kinds else []
    faults: list[Fault] = [f for f in (*by_list, *drawn) if all(part in f.name for part in options.name)]
    killers = {fault.name: [fault.killed_by] for fault in by_list}
    existing = coverage_map.collected(["tests"]) if drawn else set()
    known = coverage_map.without_gone(coverage_map.load(options.map), existing)
    chooser = Chooser(ROOT, known, first=killers)
    existing |= {fault.killed_by for fault in by_list}
    record = TrialRecord(options.map / "trials.jsonl", existing, 60 * options.minutes)
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        free: queue.Queue[Bench] = queue.Queue()
        for k in range(options.workers):
            free.put(Bench(copy_tree(Path(folder) / str(k)), chooser))

        def judge(fault: Fault) -> Trial | None:
            known = record.known(fault)
            if known or not record.has_time:
                return known
            bench = free.get()
            try:
                trial = bench.try_fault(fault)
            finally:
                free.put(bench)
            record.add(fault, trial)
            print(f"{trial.verdict:9}  {trial.name}\n{'':11}{trial.evidence}", flush=True)
            return trial

        with ThreadPoolExecutor(options.workers) as pool:
            judged = [(f, t) for f, t in zip(faults, pool.map(judge, faults), strict=True) if t]
        trials = _confirmed(judged, record, free.get())
    if len(trials) < len(faults):
        print(f"{len(trials)} of {len(faults)} are judged: the time is over, and the same command goes on.")
    return _summary(trials) or int(len(trials) < len(faults))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"of {' and '.join(KINDS)}, these alone")
    parser.add_argument("--name", action="append", default=[], help="only faults whose names hold this part")
    parser.add_argument("--each", type=int, default=16, help="faults drawn of each area")
    parser.add_argument("--seed", type=int, default=1, help="of the draw")
    parser.add_argument(
        "--workers", type=int, default=2, help="copies of the sources that are tested at once"
    )
    parser.add_argument("--area", action="append", choices=list(AREAS), help="only these")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="try no fault after so long")
    parser.add_argument("--map", type=Path, default=RECORDED, help="folder of what is recorded")
    parser.add_argument(
        "--record", action="append", metavar="TESTS", help="first record tests that the map lacks"
    )
    parser.add_argument("--remake", action="store_true", help="forget what is recorded, verdicts too")
    return parser


def _confirmed(judged: list[tuple[Fault, Trial]], record: TrialRecord, bench: Bench) -> list[Trial]:
    """Run the tests that killed once more on the unharmed sources: one that fails there proves nothing."""
    killing = sorted({test_of(trial) for _, trial in judged} - {""} - record.passing)
    failing: set[str] = set()
    while killing and (failed := bench.run(killing, 3600)):
        test = failed.partition(" ")[2]
        # A whole file is what killed where it could not be collected.
        killer = next((k for k in killing if test == k or test.startswith(f"{k}::")), None)
        if killer is None:
            raise SystemExit(f"the tests that killed do not run on the unharmed sources: {failed}")
        failing.add(killer)
        killing = killing[killing.index(killer) + 1 :]
    trials = []
    for fault, judgement in judged:
        test, why = test_of(judgement), f"{judgement.evidence} fails without the fault too"
        trial = Trial(judgement.name, Verdict.UNDECIDED, why) if test in failing else judgement
        if test and test not in record.passing:
            record.confirm(fault, trial)
        trials.append(trial)
    return trials


def _summary(trials: list[Trial]) -> int:
    """Print the figures, and what nobody has explained; the exit code."""
    reasons = explained()
    count = Counter(trial.verdict for trial in trials)
    survivors = [trial.name for trial in trials if trial.verdict not in KILLED]
    unexplained = [name for name in survivors if name not in reasons]
    killed = sum(count[verdict] for verdict in KILLED)
    equivalent = len(survivors) - len(unexplained)
    judged = len(trials) - equivalent
    print(", ".join(f"{count[verdict]} {verdict}" for verdict in Verdict))
    print(f"{killed} of {judged} killed ({killed / max(judged, 1):.1%}), {equivalent} equivalent")
    for name in unexplained:
        print(f"not explained: {name}")
    return 0 if trials and killed >= MIN_KILLED * judged and not unexplained else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
