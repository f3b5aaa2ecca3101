"""Parts of a page: verdicts, figures, tables and sections."""

from __future__ import annotations

import base64
import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass

from fpplab.diagnosis import Diagnosis, Finding
from fpplab.diagnosis.criteria import Criterion
from fpplab.report.cloud_view import CloudView


@dataclass(frozen=True)
class PageVerdict:
    """What a page says first: whether to believe what follows."""

    name: str  # of what is judged; empty where the page is about one thing only
    level: str  # `good`, `unverified`, `doubtful`, `useless`, or `none` where nothing is judged
    label: str  # the verdict in a word or two
    reason: str  # one sentence
    findings: tuple[tuple[str, str, str], ...] = ()  # cause, evidence and remedy of each, the worst first
    unknown: tuple[str, ...] = ()  # what could not be checked, and why
    thumbnail: str = ""  # PNG file as base64; empty where there is none
    criteria: tuple[Criterion, ...] = ()  # what the verdict was given by

    @classmethod
    def of(cls, diagnosis: Diagnosis, name: str = "") -> PageVerdict:
        word = diagnosis.verdict.value
        texts = (name, word, word.capitalize(), diagnosis.reason)
        findings = listed(diagnosis.findings)
        return cls(*texts, findings, diagnosis.unknown, criteria=diagnosis.criteria)


def listed(findings: Sequence[Finding]) -> tuple[tuple[str, str, str], ...]:
    return tuple(
        (finding.cause.key.replace("_", " "), finding.evidence, finding.remedy) for finding in findings
    )


@dataclass(frozen=True)
class ReportFigure:
    """A figure of the page."""

    png: str  # PNG file as base64
    alt: str  # what the figure shows, for readers without images
    caption: str  # below the figure
    wide: bool = False  # whether it takes the full width of the page

    @classmethod
    def of(cls, png: bytes, alt: str, caption: str, wide: bool = False) -> ReportFigure:
        return cls(base64.b64encode(png).decode("ascii"), alt, caption, wide)


@dataclass(frozen=True)
class ReportTable:
    """A table of text."""

    columns: tuple[str, ...]  # heads; the first column names the rows
    rows: tuple[tuple[str, ...], ...]  # cells, as many as columns
    caption: str = ""  # below the table
    has_sentences: bool = False  # whether cells hold sentences
    marked: frozenset[int] = frozenset()  # rows that are highlighted

    @property
    def csv_link(self) -> str:
        """The table as a CSV file in a `data:` link; figures without separators of thousands."""
        # A word that a spreadsheet would take for a formula gets an apostrophe before it.
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\r\n")
        writer.writerows([[_cell(word) for word in row] for row in (self.columns, *self.rows)])
        return data_link("text/csv;charset=utf-8", stream.getvalue())


def data_link(kind: str, text: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(text.encode('utf-8')).decode('ascii')}"


def _cell(word: str) -> str:
    plain = re.sub(r"(?<=\d)\u202f(?=\d)", "", word).replace("\u202f", " ")
    number = re.match(r"[+-]?[\d.]", plain)
    return plain if number or plain[:1] not in ("=", "+", "-", "@", "\t") else f"'{plain}"


@dataclass(frozen=True)
class ReportSection:
    """One section of the page."""

    title: str  # heading
    text: str = ""  # paragraph below the heading
    tables: tuple[ReportTable, ...] = ()  # below the figures
    figures: tuple[ReportFigure, ...] = ()  # below the text and the views
    views: tuple[CloudView, ...] = ()  # below the text
