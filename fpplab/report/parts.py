"""Parts of a page: figures, tables and sections."""

from __future__ import annotations

import base64
from dataclasses import dataclass

NOT_KNOWN = "–"
"""Shown where a figure is not known."""


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
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    words: bool = False


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
        Below the text.
    figures : tuple of ReportFigure
        Below the tables.
    """

    title: str
    text: str = ""
    tables: tuple[ReportTable, ...] = ()
    figures: tuple[ReportFigure, ...] = ()
