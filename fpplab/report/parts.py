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
    """What a page says first: whether to believe what follows.

    Attributes
    ----------
    name : str
        Of what is judged; empty where the page is about one thing only.
    level : str
        `good`, `doubtful`, `useless`, or `none` where nothing is judged.
    label : str
        The verdict in a word or two.
    reason : str
        One sentence.
    findings : tuple of tuple of str
        Cause, evidence and remedy of each, the worst first.
    unknown : tuple of str
        What could not be checked, and why.
    thumbnail : str
        PNG file as base64; empty where there is none.
    criteria : tuple of Criterion
        What the verdict was given by.
    """

    name: str
    level: str
    label: str
    reason: str
    findings: tuple[tuple[str, str, str], ...] = ()
    unknown: tuple[str, ...] = ()
    thumbnail: str = ""
    criteria: tuple[Criterion, ...] = ()

    @classmethod
    def of(cls, diagnosis: Diagnosis, name: str = "") -> PageVerdict:
        """Take over the verdict on a scan or a characterisation.

        Parameters
        ----------
        diagnosis : Diagnosis
            The verdict.
        name : str
            Of what is judged.

        Returns
        -------
        PageVerdict
            With the same words.
        """
        word = diagnosis.verdict.value
        words = (name, word, word.capitalize(), diagnosis.reason)
        findings = listed(diagnosis.findings)
        return cls(*words, findings, diagnosis.unknown, criteria=diagnosis.criteria)


def listed(findings: Sequence[Finding]) -> tuple[tuple[str, str, str], ...]:
    """Put findings into words.

    Parameters
    ----------
    findings : sequence of Finding
        What is wrong.

    Returns
    -------
    tuple of tuple of str
        Cause, evidence and remedy of each.
    """
    return tuple((one.cause.value.replace("_", " "), one.evidence, one.remedy) for one in findings)


@dataclass(frozen=True)
class ReportFigure:
    """A figure of the page.

    Attributes
    ----------
    png : str
        PNG file as base64.
    alt : str
        What the figure shows, for readers without images.
    caption : str
        Below the figure.
    wide : bool
        Whether it takes the full width of the page.
    """

    png: str
    alt: str
    caption: str
    wide: bool = False

    @classmethod
    def of(cls, png: bytes, alt: str, caption: str, wide: bool = False) -> ReportFigure:
        """Make a figure from a PNG file.

        Parameters
        ----------
        png : bytes
            The file.
        alt : str
            What the figure shows.
        caption : str
            Below the figure.
        wide : bool
            Whether it takes the full width of the page.

        Returns
        -------
        ReportFigure
            With the file as base64.
        """
        return cls(base64.b64encode(png).decode("ascii"), alt, caption, wide)


@dataclass(frozen=True)
class ReportTable:
    """A table of text.

    Attributes
    ----------
    columns : tuple of str
        Heads; the first column names the rows.
    rows : tuple of tuple of str
        Cells, as many as columns.
    caption : str
        Below the table.
    words : bool
        Whether cells hold sentences, which are aligned left and wrapped, instead of figures.
    marked : frozenset of int
        Rows that are highlighted.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    words: bool = False
    marked: frozenset[int] = frozenset()

    @property
    def csv_link(self) -> str:
        """The table as a CSV file in a `data:` link; figures without separators of thousands.

        A word that a spreadsheet would take for a formula gets an apostrophe before it.
        """
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\r\n")
        writer.writerows([[_cell(word) for word in row] for row in (self.columns, *self.rows)])
        return data_link("text/csv;charset=utf-8", stream.getvalue())


def data_link(kind: str, text: str) -> str:
    """Put a text into a `data:` link.

    Parameters
    ----------
    kind : str
        Its media type.
    text : str
        The text.

    Returns
    -------
    str
        The link.
    """
    return f"data:{kind};base64,{base64.b64encode(text.encode('utf-8')).decode('ascii')}"


def _cell(word: str) -> str:
    """A cell for a spreadsheet."""
    plain = re.sub(r"(?<=\d)\u202f(?=\d)", "", word).replace("\u202f", " ")
    number = re.match(r"[+-]?[\d.]", plain)
    return plain if number or plain[:1] not in ("=", "+", "-", "@", "\t") else f"'{plain}"


@dataclass(frozen=True)
class ReportSection:
    """One section of the page.

    Attributes
    ----------
    title : str
        Heading.
    text : str
        Paragraph below the heading.
    tables : tuple of ReportTable
        Below the figures.
    figures : tuple of ReportFigure
        Below the text and the views.
    views : tuple of CloudView
        Below the text.
    """

    title: str
    text: str = ""
    tables: tuple[ReportTable, ...] = ()
    figures: tuple[ReportFigure, ...] = ()
    views: tuple[CloudView, ...] = ()
