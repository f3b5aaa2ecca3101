"""A report: one HTML file that fetches nothing, with the verdicts before all else."""

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from fpplab.core.files import write_text
from fpplab.core.version import __version__
from fpplab.report.parts import PageVerdict, ReportSection, ReportTable, data_link
from fpplab.report.wording import grouped
from fpplab.results.provenance import LABELS, NOT_RECORDED, Provenance

IN_THE_HEAD = ("rig", "item", "plan", "taken", "calibration", "calibration_age")
"""Of a page's one provenance, what its head says too."""
GENERATOR, LONGEST_HEAD = b'<meta name="generator" content="fpplab">', 1024
"""By what a page is known as ours, and within how many bytes."""
UNFINISHED = b'<meta name="generator" content="fpplab"><meta name="fpplab" content="unfinished">'
"""The head of a page whose run has not drawn it yet, or was ended before."""


@dataclass(frozen=True)
class PageBasis:
    """What a page is based on: verdicts, where its figures come from, and the same as data."""

    verdicts: tuple[PageVerdict, ...] = ()  # at the top of the page
    provenance: Mapping[str, Provenance] = field(default_factory=dict)  # by name of what was measured
    answer: Mapping[str, Any] = field(default_factory=dict)


def write_page(
    path: Path,
    title: str,
    summary: Sequence[ReportTable],
    sections: Sequence[ReportSection],
    head_facts: Mapping[str, str] | None = None,
    written_at: datetime | None = None,
    verdicts_and_sources: PageBasis | None = None,
) -> None:
    page_basis = verdicts_and_sources or PageBasis()
    environment = _environment()
    viewed = any(section.views for section in sections)
    script = environment.get_template("cloud_view.js").render() if viewed else ""
    sources = _provenance_table(page_basis.provenance) if page_basis.provenance else None
    tables = [*summary, *(table for section in sections for table in section.tables)]
    page = environment.get_template("report.html.j2").render(
        title=title,
        when=(written_at or datetime.now().astimezone()).strftime("%Y-%m-%d %H:%M %Z").strip(),
        facts={**_shared_head_facts(page_basis.provenance), **(head_facts or {})},
        verdicts=page_basis.verdicts,
        summary=summary,
        sections=sections,
        provenance=sources,
        data=data_link("application/json", _as_json(title, page_basis, tables)),
        script=script,
        script_hash=base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii"),
        version=__version__,
    )
    write_text(path, page)


def begin_page(path: Path) -> None:
    """Leave a page that says that it is not drawn yet, so that a result without a report is known as such."""
    write_text(
        path, f"<!DOCTYPE html>{UNFINISHED.decode()}<p>The run that draws this report has not ended.\n"
    )


def is_unfinished(path: Path) -> bool:
    return _begins_with(path, UNFINISHED)


def is_report(path: Path) -> bool:
    """Tell whether a file is a page that this module wrote."""
    # Commands write their page before their result, so a page alone is of a run that was ended between.
    return _begins_with(path, GENERATOR)


def _begins_with(path: Path, mark: bytes) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        return mark in stream.read(LONGEST_HEAD)


def _environment() -> Environment:
    loader = PackageLoader("fpplab.report", "templates")
    environment = Environment(
        loader=loader,
        autoescape=lambda name: name is None or not name.endswith(".js"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["grouped"] = grouped
    return environment


def _shared_head_facts(sources: Mapping[str, Provenance]) -> dict[str, str]:
    """The most important facts, where they are the same for everything on the page."""
    tables = [dict(source.values) for source in sources.values()]
    return {
        LABELS[key]: tables[0][key] or NOT_RECORDED
        for key in IN_THE_HEAD
        if tables and all(key in table and table[key] == tables[0][key] for table in tables)
    }


def _provenance_table(sources: Mapping[str, Provenance]) -> ReportTable:
    present = [key for key in LABELS if any(key in source.values for source in sources.values())]
    rows = tuple(
        (LABELS[key], *(source.values.get(key, "") or NOT_RECORDED for source in sources.values()))
        for key in present
    )
    apart = frozenset(k for k, row in enumerate(rows) if len(set(row[1:])) > 1)
    caption = "As recorded by sessions, calibrations and devices."
    if len(sources) > 1:
        caption += " Marked: what is not the same for all." if apart else " The same for all."
    columns = ("", *sources) if len(sources) > 1 else ("", "As recorded")
    return ReportTable(columns, rows, caption, has_sentences=True, marked=apart)


def _as_json(title: str, basis: PageBasis, tables: Sequence[ReportTable]) -> str:
    return json.dumps(
        {
            "title": title,
            **basis.answer,
            "provenance": {name: source.summary() for name, source in basis.provenance.items()},
            "tables": [{"columns": table.columns, "rows": table.rows} for table in tables],
        },
        indent=1,
        default=_plain,
    )


def _plain(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else str(value)
