"""Walk through the checks of a release: `python -m tests.release [NAME ...]`, or `make release`."""

import argparse
import sys
from collections.abc import Sequence

from tests.release.checks import CHECKS, Check


def main(asked: list[str], checks: Sequence[Check] = CHECKS) -> int:
    """Make the checks in their order, and say of each how it ended; 1 where one failed or stays open."""
    parser = argparse.ArgumentParser(prog="python -m tests.release", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="checks to make; all by default")
    parser.add_argument(
        "--confirmed", nargs="*", default=[], metavar="NAME", help="checks that you made yourself"
    )
    parser.add_argument("--list", action="store_true", help="only say which there are")
    given = parser.parse_args(asked)
    known = [check.name for check in checks]
    for name in (*given.names, *given.confirmed):
        if name not in known:
            parser.error(f"there is no check '{name}'; there are {', '.join(known)}")
    open_ones = 0
    for check in checks:
        if given.names and check.name not in given.names:
            continue
        state = "to do" if given.list else _state(check, check.name in given.confirmed)
        open_ones += state != "ok"
        print(f"{check.name:<10} {check.what}: {state}", flush=True)
    return int(open_ones > 0 and not given.list)


def _state(check: Check, is_confirmed: bool) -> str:
    if check.complain is None:
        return "ok" if is_confirmed else f"OPEN; do it, and add --confirmed {check.name}"
    complaint = check.complain()
    return f"FAILED: {complaint}" if complaint else "ok"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
