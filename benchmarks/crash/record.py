"""What came of each case, kept as it ends: an interrupted run goes on where it stopped."""

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from benchmarks.crash.programs import DisturbedProgram
from fpplab.core.journals import append_line, cut_torn_line, whole_lines


@dataclass(frozen=True)
class CrashCase:
    """One output of a program, disturbed as often as it was."""

    part: str  # which part of the benchmark it belongs to
    program: str  # name of the program
    number: int  # of the case among those of the same part and program
    disturbances: int  # how often the program was disturbed
    seconds: float  # what the case took
    failures: list[tuple[str, str]] = field(default_factory=list)  # (str, str)


class CrashRecord:
    """The cases until now."""

    def __init__(self, path: Path, seconds: float = float("inf")) -> None:
        self._path, self._end = path, time.monotonic() + seconds
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        cut_torn_line(path)
        self.cases = [CrashCase(**json.loads(line)) for line in whole_lines(path)]

    def add(self, case: CrashCase) -> None:
        """Keep a case, and describe what went wrong on stderr."""
        append_line(self._path, json.dumps(asdict(case)))
        self.cases.append(case)
        for kind, words in case.failures:
            sys.stderr.write(f"{kind}: {words}\n")
            sys.stderr.flush()

    def of(self, part: str, program: str | None = None) -> list[CrashCase]:
        """Give the cases of a part."""
        return [one for one in self.cases if one.part == part and program in (None, one.program)]

    @property
    def has_time(self) -> bool:
        """Whether a further case may be begun."""
        return time.monotonic() < self._end


@dataclass(frozen=True)
class Campaign:
    """What one part of the benchmark is to do."""

    folder: Path  # what `prepare` filled
    programs: tuple[DisturbedProgram, ...]  # which; each is disturbed by its share
    count: int  # how many times in all
    seed: int  # of the random moments
    record: CrashRecord  # cases that are done already, and those that follow

    def due(self, part: str) -> Iterator[tuple[DisturbedProgram, int]]:
        """Tell what is left to be done."""
        whole = sum(program.share for program in self.programs)
        for program in self.programs:
            wanted = max(1, round(self.count * program.share / whole)) if self.count else 0
            done = sum(case.disturbances for case in self.record.of(part, program.name))
            if wanted > done and self.record.has_time:
                yield program, wanted - done
