"""Runs tests against a fault that is seeded into a copy of the sources."""

import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from tests.mutants.choice import Chooser, importers
from tests.mutants.fault import Fault

STARTING_S, TIMES_SLOWER = 300.0, 5.0
"""A run of tests is given so long to start and compile, and so many times the time that the map knows."""


class Verdict(StrEnum):
    """What became of a fault."""

    KILLED = "killed"
    HUNG = "hung"
    """Killed: tests that end on the unharmed sources do not end."""
    SURVIVED = "SURVIVED"
    UNTESTED = "UNTESTED"
    """No test executes it: it survives."""
    UNDECIDED = "UNDECIDED"
    """The tests fail, or do not end, on the unharmed sources too."""


KILLED = (Verdict.KILLED, Verdict.HUNG)


@dataclass(frozen=True)
class Trial:
    """A verdict, and the test that reached it or how many there were."""

    name: str
    verdict: Verdict
    evidence: str


def failed_test(ended: str) -> str:
    """The test, or the file of tests, that ended a run; empty where something else did, such as a crash."""
    match = re.match(r"(?:FAILED|ERROR) (tests/\S.*)", ended)
    return match[1] if match else ""


class Bench:
    """A copy of the sources in which one fault after the other is tried."""

    def __init__(self, tree: Path, chooser: Chooser) -> None:
        self._tree, self._chooser = tree, chooser

    def try_fault(self, fault: Fault) -> Trial:
        """Seed a fault, run its tests up to the first failure, and mend it again."""
        tests = self._chooser.tests_for(fault)
        if not tests:
            return Trial(fault.name, Verdict.UNTESTED, f"no test executes line {fault.line}")
        limit = STARTING_S + TIMES_SLOWER * self._chooser.seconds_of(tests)
        path = self._tree / fault.file
        source, times = path.read_bytes(), path.stat()
        path.write_bytes(fault.seeded(source))
        self._forget_machine_code(fault)
        try:
            ended = self.run(tests, limit)
        finally:
            path.write_bytes(source)
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))  # what numba compiled stays valid
            self._forget_machine_code(fault)
        if ended is None:
            ends = self.run(tests, limit) == ""
            return Trial(fault.name, Verdict.HUNG if ends else Verdict.UNDECIDED, f"after {limit:.0f} s")
        if not ended:
            return Trial(fault.name, Verdict.SURVIVED, f"{len(tests)} tests")
        if not failed_test(ended) and self.run(tests, limit):
            return Trial(fault.name, Verdict.UNDECIDED, ended)
        return Trial(fault.name, Verdict.KILLED, ended)

    def run(self, tests: list[str], limit: float) -> str | None:
        """Run tests up to the first failure: its name, or what else ended them; empty if all pass.

        None where they have not come to an end in so many seconds.
        """
        command = [sys.executable, "-m", "pytest", *tests, "-x", "-q", "--no-header", "--tb=no"]
        command += ["-p", "no:cacheprovider"]
        environment = {**os.environ, "PYTHONPATH": str(self._tree), "PYTHONDONTWRITEBYTECODE": "1"}
        process = subprocess.Popen(
            command,
            cwd=self._tree,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        try:
            output, _ = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            return None
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        if process.returncode == 0:
            return ""
        failed = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))]
        # A fault may end the process before it prints anything, such as by a signal to its own group.
        printed = output.strip().splitlines() or [f"exit code {process.returncode} without a word"]
        return failed[0].split(" - ")[0] if failed else printed[-1]

    def _forget_machine_code(self, fault: Fault) -> None:
        """Delete what numba compiled of code that calls the fault's: it looks at its own file alone."""
        for file in (fault.file, *importers(self._tree, fault.file)):
            cached = self._tree / Path(file).parent / "__pycache__"
            for compiled in cached.glob(f"{Path(file).stem}.*.nb?"):
                compiled.unlink()
