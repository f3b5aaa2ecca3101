"""Writing commands on disks that are full or vanish: `python -m tests.full_disk [NAME …] [--part PART]`.

Parts: `pages`, on a file system with room for 0, 1, 2 … pages; `writes`, every writing command, whose disk is
full, or whose user has no quota left, from its n-th write on; `vanish`, scans whose disk is gone midway.
"""

import argparse
import errno
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.crash.programs import SCAN, SCAN_EMULATED, prepare
from tests.full_disk.commands import COMMANDS
from tests.full_disk.disks import can_mount
from tests.full_disk.every_write import EveryWrite
from tests.full_disk.inputs import EVERY_COMMAND, prepare_inputs
from tests.full_disk.trial import try_every_size
from tests.full_disk.vanishing import can_vanish, vanishing_disks
from tests.full_disk.writes import can_refuse, refusing_program

CANNOT = 3
VANISHING, SEED = 10, 1
"""How often a disk vanishes under each scan."""


def pages(folder: Path, names: list[str]) -> Iterator[list[str]]:
    """Fill true disks page by page."""
    if not can_mount(folder / "trial"):
        raise PermissionError("this process may not mount a file system; run it as root")
    for writing in COMMANDS:
        if not names or writing.name in names:
            *refused, last = try_every_size(writing, folder / writing.name)
            complaints = [complaint for complaint in (*refused, last) if complaint]
            print(f"pages   {writing.name:14} {len(refused):4} full disks", flush=True)
            yield complaints


def writes(folder: Path, names: list[str]) -> Iterator[list[str]]:
    """Refuse writes from the n-th on, for want of space and for want of quota."""
    if not can_refuse():
        raise PermissionError("there is no C compiler `cc`")
    prepare_inputs(folder)
    for error in (errno.ENOSPC, errno.EDQUOT):
        (folder / errno.errorcode[error]).mkdir()
        with refusing_program(folder / errno.errorcode[error]) as program:
            for command in EVERY_COMMAND:
                if not names or command.name in names:
                    found = EveryWrite(program, command, folder, folder / "disk", error).run()
                    print(
                        f"writes  {command.name:14} {errno.errorcode[error]} {found.writes:5} writes, "
                        f"{found.tried:4} tried, {found.endings:3} endings",
                        flush=True,
                    )
                    yield found.complaints


def vanish(folder: Path, names: list[str]) -> Iterator[list[str]]:
    """Take the disk away from scans."""
    if not can_vanish(folder / "trial"):
        raise PermissionError("this process may not mount a loop device; run it as root")
    for k, program in enumerate((SCAN, SCAN_EMULATED)):
        if not names or program.name in names:
            place = folder / str(k)
            place.mkdir()
            prepare(place, (program,))
            complaints = list(vanishing_disks(place, program, VANISHING, SEED))
            print(f"vanish  {program.name:28} {len(complaints):3} times", flush=True)
            yield [complaint for complaint in complaints if complaint]


PARTS = {"pages": pages, "writes": writes, "vanish": vanish}


def main(words: list[str]) -> int:
    """Try commands, and print what came of each."""
    parser = argparse.ArgumentParser(prog="python -m tests.full_disk", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these commands")
    parser.add_argument("--part", action="append", choices=list(PARTS), help="only these")
    asked = parser.parse_args(words)
    wrong, left_out = 0, 0
    for part in asked.part or PARTS:
        with tempfile.TemporaryDirectory(prefix="full-disk-") as folder:
            try:
                for complaints in PARTS[part](Path(folder), asked.names):
                    print(f"{'':8}{len(complaints)} wrong", *complaints[:5], sep="\n          ", flush=True)
                    wrong += len(complaints)
            except PermissionError as error:
                print(f"NOT RUN: {part}: {error}", file=sys.stderr)
                left_out += 1
    return 1 if wrong else CANNOT if left_out else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
