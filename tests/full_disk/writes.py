"""Commands whose n-th write into a folder fails, and every later one, as on a disk that is full by then."""

import mmap
import os
import shutil
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.support.commands import LONGEST_S, ROOT, Outcome
from tests.support.ready_program import ReadyProgram

SOURCE = Path(__file__).with_name("refuse_writes.c")
ORDERS = "FPPLAB_REFUSED_WRITES"
HEAD = struct.Struct("<qqq4096s")


def can_refuse() -> bool:
    """Whether there is a compiler for the library that refuses."""
    return shutil.which("cc") is not None


class RefusingProgram:
    """The program, ready to be forked, with the library that refuses writes."""

    def __init__(self, program: ReadyProgram, orders: mmap.mmap) -> None:
        self._program, self._orders = program, orders

    def run(self, words: list[str], cwd: Path, disk: Path, first: int = 0, error: int = 0) -> Outcome:
        """Run a command whose writes below `disk` fail from number `first` on; never where that is 0."""
        self._orders[:] = HEAD.pack(first, error, 0, f"{disk}/".encode())
        done = self._program.run(words, cwd, dict(os.environ), LONGEST_S)
        return Outcome(done.returncode, done.stdout, done.stderr)

    @property
    def writes(self) -> int:
        """How many writes the last command made, or tried to make."""
        return int(HEAD.unpack(self._orders[:])[2])


@contextmanager
def refusing_program(folder: Path) -> Iterator[RefusingProgram]:
    """Compile the library in a folder, and start the program with it."""
    library, orders = folder / "refuse_writes.so", folder / "orders"
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, SOURCE, "-ldl"], check=True)
    orders.write_bytes(bytes(HEAD.size))
    own = {"LD_PRELOAD": str(library), ORDERS: str(orders)}
    before = dict(os.environ)
    os.environ.update(own)
    try:
        program = ReadyProgram(ROOT)
    finally:
        os.environ.clear()
        os.environ.update(before)
    with orders.open("r+b") as file:
        shared = mmap.mmap(file.fileno(), HEAD.size)
    try:
        yield RefusingProgram(program, shared)
    finally:
        program.close()
        shared.close()
