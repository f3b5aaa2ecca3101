"""What became of each fault, kept as it is judged: an interrupted run goes on where it stopped."""

import hashlib
import json
import time
from pathlib import Path

from fpplab.core.journals import append_line, cut_torn_line, whole_lines
from tests.mutants.fault import Fault
from tests.mutants.judge import KILLED, Trial, Verdict, failed_test
from tests.mutants.tree import ROOT


class TrialRecord:
    """Trials of earlier runs and of this one, in a file of JSON lines.

    A fault that was killed is not tried again as long as its source is the same and the test that killed it
    is among those that exist; one that survived is, for a test may have come that notices it. After
    `seconds` no further fault is tried.
    """

    def __init__(self, path: Path, existing: set[str], seconds: float = float("inf")) -> None:
        self._path, self._end = path, time.monotonic() + seconds
        self._existing = existing | {test.partition("::")[0] for test in existing}
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        cut_torn_line(path)
        self._killed: dict[tuple[str, str], Trial] = {}
        self.passing: set[str] = set()
        for line in whole_lines(path):
            kept = json.loads(line)
            self._remember(kept["source"], Trial(kept["name"], Verdict(kept["verdict"]), kept["evidence"]))
            self.passing.update(kept["passing"])

    def known(self, fault: Fault) -> Trial | None:
        """The trial of a fault that was killed in the source as it is now, by a test that is still there."""
        trial = self._killed.get((fault.name, _sum(fault.file)))
        gone = trial is not None and test_of(trial) not in {"", *self._existing}
        return None if gone else trial

    def add(self, fault: Fault, trial: Trial) -> None:
        """Keep a trial."""
        self._write(fault.file, trial, [])

    def confirm(self, fault: Fault, trial: Trial) -> None:
        """Keep that the test that killed a fault passes on the unharmed sources, or else that it does not."""
        self._write(fault.file, trial, [test_of(trial)] if trial.verdict is Verdict.KILLED else [])

    @property
    def has_time(self) -> bool:
        """Whether a further fault may be tried."""
        return time.monotonic() < self._end

    def _write(self, file: str, trial: Trial, passing: list[str]) -> None:
        source = _sum(file)
        kept = {"name": trial.name, "source": source, "verdict": trial.verdict, "evidence": trial.evidence}
        append_line(self._path, json.dumps(kept | {"passing": passing}))
        self._remember(source, trial)
        self.passing.update(passing)

    def _remember(self, source: str, trial: Trial) -> None:
        self._killed.pop((trial.name, source), None)
        if trial.verdict in KILLED:
            self._killed[trial.name, source] = trial


def test_of(trial: Trial) -> str:
    """The test that killed a fault; empty where something else ended it."""
    return failed_test(trial.evidence) if trial.verdict is Verdict.KILLED else ""


def _sum(file: str) -> str:
    return hashlib.sha256((ROOT / file).read_bytes()).hexdigest()[:16]
