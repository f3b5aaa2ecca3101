"""Scan again and again on the emulated bench, and plug its devices out and in: `python -m tests.soak`."""

import argparse
import os
import shutil
import sys
import tempfile
from pathlib import Path

from tests.soak.measure import SETTLED, Held, growth, words
from tests.soak.rounds import plug_cycles, scans


def main(asked: list[str]) -> int:
    """Run both, and print what the process held."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak")
    parser.add_argument("--scans", type=int, default=500)
    parser.add_argument("--cycles", type=int, default=100, help="of each device")
    given = parser.parse_args(asked)
    os.environ.setdefault("FPPLAB_ALLOW_BACKEND", "tests")
    wrong = 0
    folder = Path(tempfile.mkdtemp(prefix="soak-"))
    try:
        for name, rounds in (
            ("scans", scans(folder, given.scans)),
            ("reconnections", plug_cycles(folder, given.cycles)),
        ):
            held: list[Held] = []
            for _ in rounds:
                held.append(Held.now())
            if not held:
                continue
            complaints = growth(held)
            first = words(held[min(SETTLED, len(held) - 1)])
            print(f"{len(held)} {name}: at first {first}; at last {words(held[-1])}")
            print("  " + ("; ".join(complaints) or "flat"), flush=True)
            wrong += len(complaints)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
