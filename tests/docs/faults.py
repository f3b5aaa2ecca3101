"""`python -m tests.docs.faults` writes docs/faults.md from docs/faults.yaml."""

from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]
TABLE, PAGE = ROOT / "docs" / "faults.yaml", ROOT / "docs" / "faults.md"
HEAD = """# Faults

What may go wrong, what the operator sees, what is lost, and the test that proves it.
`python -m tests.docs.faults` writes this page from `faults.yaml`.
"""
COLUMNS = ("fault", "seen", "lost", "proved_by")
TITLES = ("Fault", "What the operator sees", "What is lost", "Proved by")


def groups() -> list[dict[str, Any]]:
    """The table."""
    found: list[dict[str, Any]] = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    return found


def page() -> str:
    """The page that the table makes."""
    parts = [HEAD]
    for group in groups():
        rows = [[row[name] for name in COLUMNS] for row in group["faults"]]
        lines = [TITLES, ("---",) * len(TITLES), *((*row[:-1], _link(row[-1])) for row in rows)]
        table = "\n".join("| " + " | ".join(line) + " |" for line in lines)
        parts.append(f"## {group['group']}\n\n{table}\n")
    return "\n".join(parts)


def _link(test: str) -> str:
    file, _, name = test.partition("::")
    return f"[{name}](../{file})"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
