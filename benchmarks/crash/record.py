"""What came of each case, kept as it ends: an interrupted run goes on where it stopped."""

from __future__ import annotations

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
    """One output of a program, disturbed as often as it was.

    Attributes
    ----------
    part : str
        Which part of the benchmark it belongs to.
    program : str
        Name of the program.
    number : int
        Of the case among those of the same part and program.
    disturbances : int
        How often the program was disturbed.
    seconds : float
        What the case took.
    failures : list of (str, str)
        Kind and description of each thing that went wrong.
    """

    part: str
    program: str
    number: int
    disturbances: int
    seconds: float
    failures: list[tuple[str, str]] = field(default_factory=list)


class CrashRecord:
    """The cases until now.

    Parameters
    ----------
    path : Path
        File of JSON lines, which is gone on with if it exists.
    seconds : float
        After so long no further case is begun.
    """

    def __init__(self, path: Path, seconds: float = float("inf")) -> None:
        self._path, self._end = path, time.monotonic() + seconds
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        cut_torn_line(path)
        self.cases = [CrashCase(**json.loads(line)) for line in whole_lines(path)]

    def add(self, case: CrashCase) -> None:
        """Keep a case, and describe what went wrong on stderr.

        Parameters
        ----------
        case : CrashCase
            The case.
        """
        append_line(self._path, json.dumps(asdict(case)))
        self.cases.append(case)
        for kind, words in case.failures:
            sys.stderr.write(f"{kind}: {words}\n")
            sys.stderr.flush()

    def of(self, part: str, program: str | None = None) -> list[CrashCase]:
        """Give the cases of a part.

        Parameters
        ----------
        part : str
            Its name.
        program : str, optional
            Name of the program; by default all.

        Returns
        -------
        list of CrashCase
            In their order.
        """
        return [one for one in self.cases if one.part == part and program in (None, one.program)]

    @property
    def has_time(self) -> bool:
        """Whether a further case may be begun."""
        return time.monotonic() < self._end


@dataclass(frozen=True)
class Campaign:
    """What one part of the benchmark is to do.

    Attributes
    ----------
    folder : Path
        What `prepare` filled.
    programs : tuple of DisturbedProgram
        Which; each is disturbed by its share.
    count : int
        How many times in all.
    seed : int
        Of the random moments.
    record : CrashRecord
        Cases that are done already, and those that follow.
    """

    folder: Path
    programs: tuple[DisturbedProgram, ...]
    count: int
    seed: int
    record: CrashRecord

    def due(self, part: str) -> Iterator[tuple[DisturbedProgram, int]]:
        """Tell what is left to be done.

        Parameters
        ----------
        part : str
            Name of the part.

        Yields
        ------
        program : DisturbedProgram
            A program that has not been disturbed often enough.
        times : int
            How often it still has to be.
        """
        whole = sum(program.share for program in self.programs)
        for program in self.programs:
            wanted = max(1, round(self.count * program.share / whole)) if self.count else 0
            done = sum(case.disturbances for case in self.record.of(part, program.name))
            if wanted > done and self.record.has_time:
                yield program, wanted - done
