"""One writing command whose disk is full from its first write on, from its second, … from its last."""

import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.crash.content import content_of
from fpplab.core.errors import FppError
from fpplab.core.session_names import JOURNAL
from fpplab.sessions.session import Session
from tests.full_disk.writes import RefusingProgram
from tests.support.commands import Outcome

DONE, DATA = 0, 4
FULL = "no space left on the disk"


@dataclass(frozen=True)
class WritingCommand:
    """A command that writes.

    `words` are those that follow `fpplab`; `{out}` is the output, whose suffix is `suffix`. `begin` fills the
    disk beforehand, given the folder of inputs and the output. What `mends` begins with a session that cannot
    be read, and may move what it finds.
    """

    name: str
    words: str
    suffix: str = ""
    begin: Callable[[Path, Path], object] | None = None
    mends: bool = False


@dataclass
class Found:
    """How many writes there are, which of them were tried, and what was wrong."""

    writes: int = 0
    tried: int = 0
    endings: int = 0
    complaints: list[str] = field(default_factory=list)


@dataclass
class EveryWrite:
    """Trials of one command: each has a disk of its own, and the command's inputs lie elsewhere."""

    program: RefusingProgram
    command: WritingCommand
    inputs: Path
    disk: Path
    error: int
    resolution: int = 1
    """Between two writes that are no further apart than this, none is tried."""
    said: str = FULL
    found: Found = field(default_factory=Found)
    expected: dict[str, str] = field(default_factory=dict)
    finished: set[str] = field(default_factory=set)

    @property
    def out(self) -> Path:
        return self.disk / f"out{self.command.suffix}"

    def run(self) -> Found:
        """Try every write that ends the command in a way of its own."""
        self._prepare()
        done = self._command()
        if done.code != DONE:
            self.found.complaints.append(f"fails undisturbed: {done.err[-300:]}")
            return self.found
        self.expected, self.found.writes = content_of(self.out), self.program.writes
        last = self.found.writes
        self._between(1, self._ending(1), last, self._ending(last))
        self.found.endings = len(self.finished)
        return self.found

    def _between(self, low: int, first: str, high: int, last: str) -> None:
        """Between two writes at which the command ends alike, it ends so at all others."""
        if high - low <= self.resolution or first == last:
            return
        middle = (low + high) // 2
        ending = self._ending(middle)
        self._between(low, first, middle, ending)
        self._between(middle, ending, high, last)

    def _ending(self, number: int) -> str:
        """How the command ends if the disk is full from its so many-th write on."""
        self._prepare()
        self.found.tried += 1
        before = content_of(self.disk)
        done = self._command(number, self.error)
        names = sorted(p.relative_to(self.disk).as_posix() for p in self.disk.rglob("*"))
        ending = re.sub(r"[0-9.]+|\.[a-z0-9_]{8}\b", "", f"{done.code} {done.err} {names}")
        self._note(number, self._complaint(done, names, before))
        if ending not in self.finished:
            self.finished.add(ending)
            self._note(number, self._unfinished())
        return ending

    def _complaint(self, done: Outcome, names: list[str], before: dict[str, str]) -> str:
        if done.code == DONE:
            return "" if content_of(self.out) == self.expected else "ends with 0 and another result"
        if done.code != DATA or "Traceback" in done.err:
            return f"exit {done.code}: {done.err[-300:]}"
        if self.said not in done.err:
            return f"does not say '{self.said}': {done.err[-300:]}"
        now = content_of(self.disk)
        if lost := [name for name in before if before[name] not in now.values()]:
            return f"lost {lost}"
        if drafts := [n for n in names if any(part.startswith(".") for part in Path(n).parts)]:
            return f"left {drafts}"
        return "" if self.command.mends else self._unreadable()

    def _unreadable(self) -> str:
        """Which session cannot be read; empty if none."""
        try:
            for journal in self.disk.rglob(JOURNAL):
                session = Session.open(journal.parent)
                for record in session.records:
                    session.read(record.index)
        except FppError as error:
            return f"left a session that cannot be read: {error}"
        return ""

    def _unfinished(self) -> str:
        """What is wrong after the same command with space enough; empty if nothing."""
        done = self._command()
        if done.code != DONE and "exists already" not in done.err:
            return f"the same command with space enough: exit {done.code}: {done.err[-300:]}"
        now = content_of(self.out)
        apart = sorted(n for n in {*now, *self.expected} if now.get(n) != self.expected.get(n))
        return f"completed, it differs in {', '.join(apart)}" if apart else ""

    def _note(self, number: int, complaint: str) -> None:
        if complaint:
            self.found.complaints.append(f"write {number}: {complaint}")

    def _prepare(self) -> None:
        shutil.rmtree(self.disk, ignore_errors=True)
        self.disk.mkdir(parents=True)
        if self.command.begin:
            self.command.begin(self.inputs, self.out)

    def _command(self, first: int = 0, error: int = 0) -> Outcome:
        words = self.command.words.format(out=self.out).split()
        return self.program.run(words, self.inputs, self.disk, first, error)
