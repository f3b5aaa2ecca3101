"""Tables of the reference: causes from the diagnosis, faults and reports from the files beside the pages."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import yaml

from docs.generate.pages import DOCS
from fpplab.diagnosis import known_causes

FAULTS, FIELD_REPORTS = DOCS / "faults.yaml", DOCS / "field-reports.yaml"


def groups(path: Path) -> list[dict[str, Any]]:
    """Give the groups of rows of `FAULTS` or `FIELD_REPORTS`.

    Parameters
    ----------
    path : Path
        YAML.

    Returns
    -------
    list of dict
        Each with the name of its `group` and its `rows`.
    """
    read: list[dict[str, Any]] = yaml.safe_load(path.read_text(encoding="utf-8"))
    return read


def _table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [titles, ("---",) * len(titles), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def causes_page() -> str:
    """Write the page of all causes that a diagnosis knows.

    Returns
    -------
    str
        Markdown.
    """
    rows = [
        (
            f"`{one.key}`",
            f"{one.meaning} *Remedy:* {one.remedy}.",
            f"{one.measured}. *Limit:* {one.limit}. *Seen in:* {one.seen_in}.",
        )
        for one in known_causes().values()
    ]
    titles = ("cause", "meaning", "what is measured")
    return (
        "# All causes\n\nWhat findings name, in alphabetical order. [Verdicts](../verdicts.md) explains how "
        "a verdict follows from them; the [gallery](../gallery.md) shows what many of them look like.\n\n"
        + _table(titles, rows)
    )


def faults_page() -> str:
    """Write the page of faults: what the operator sees, what is lost, and the test that proves it.

    Returns
    -------
    str
        Markdown.
    """
    parts = [
        "# Faults\n\nWhat may go wrong, what the operator sees, what is lost, and the test that proves it.\n"
    ]
    for group in groups(FAULTS):
        rows = [(row["fault"], row["seen"], row["lost"], _test(row["proved_by"])) for row in group["rows"]]
        titles = ("fault", "what the operator sees", "what is lost", "proved by")
        parts.append(f"## {group['group']}\n\n{_table(titles, rows)}")
    return "\n".join(parts)


def field_reports_page() -> str:
    """Write the page of public reports of faults at benches.

    Returns
    -------
    str
        Markdown.
    """
    parts = [
        "# What others have met at benches\n\nPublic reports of faults that a bench like yours may have. "
        "fpplab *prevents* the fault, *explains* it in an error or finding, or only *documents* it; the last "
        "column names the test that proves it.\n"
    ]
    for group in groups(FIELD_REPORTS):
        rows = [
            (f"[{row['report']}]({row['link']})", row["happened"], row["here"], _test(row["test"]))
            for row in group["rows"]
        ]
        parts.append(f"## {group['group']}\n\n{_table(('report', 'what happened', 'here', 'test'), rows)}")
    return "\n".join(parts)


def _test(name: str) -> str:
    file, _, function = name.partition("::")
    return f"`{function}` in `{file}`"
