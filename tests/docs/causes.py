"""`python -m tests.docs.causes` writes the table of causes in docs/verdicts.md from the causes themselves."""

import re
from pathlib import Path

from fpplab.diagnosis import known_causes

PAGE = Path(__file__).parents[2] / "docs" / "verdicts.md"
TITLES = ("cause", "what is measured", "limit", "seen in")
TABLE = re.compile(r"^\| cause \|.*?\n(?=\n)", re.MULTILINE | re.DOTALL)


def table() -> str:
    """The table of all causes."""
    rows = [(f"`{one.key}`", one.measured, one.limit, one.seen_in) for one in known_causes().values()]
    lines = [TITLES, ("---",) * len(TITLES), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def page() -> str:
    """The page with its table as it should be."""
    return TABLE.sub(lambda _: table(), PAGE.read_text(encoding="utf-8"), count=1)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
