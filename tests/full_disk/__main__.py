"""Writing commands on disks that are full at every page: `python -m tests.full_disk [NAME …]`."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.full_disk.commands import COMMANDS
from tests.full_disk.disks import can_mount
from tests.full_disk.trial import try_every_size

CANNOT = 3


def main(names: list[str]) -> int:
    """Try commands, and print what came of each."""
    wrong = 0
    with tempfile.TemporaryDirectory(prefix="full-disk-") as folder:
        if not can_mount(Path(folder) / "trial"):
            print("NOT RUN: this process may not mount a file system; run it as root", file=sys.stderr)
            return CANNOT
        for writing in COMMANDS:
            if names and writing.name not in names:
                continue
            sizes, complaints = 0, []
            for complaint in try_every_size(writing, Path(folder) / writing.name):
                sizes += 1
                complaints += [complaint] if complaint else []
            print(
                f"{writing.name:10} {sizes - 1:4} full disks, {len(complaints)} wrong",
                *complaints[:5],
                sep="\n  ",
            )
            wrong += len(complaints)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
