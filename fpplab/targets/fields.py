"""Fields of a target file that every kind of board has."""

from typing import Annotated

from pydantic import Field

from fpplab.core.config import Document, Positive

GridCount = Annotated[int, Field(ge=2, le=200)]
Reflectance = Annotated[float, Field(ge=0, le=1)]


class GridFields(Document):
    """The kind of a board and the grid that its points lie on."""

    kind: str
    """Name of the kind of board: a module of `fpplab.targets.kinds`."""

    size_mm: tuple[Positive, Positive]
    """(width, height) of the whole board in mm."""

    counts: tuple[GridCount, GridCount]
    """Number of points (columns, rows)."""

    spacing_mm: tuple[Positive, Positive]
    """Pitch of the points along x and y in mm; for boards with corners the side of a square."""


class PrintFields(Document):
    """How accurately and in which reflectances a board was made."""

    tolerance_mm: Positive | None = None
    """Standard deviation in mm of the points from where they are drawn.

    Characterisation starts from it to estimate how far the points are off.
    """

    scale_tolerance: Annotated[float, Field(ge=0, le=0.1)] | None = None
    """Relative standard uncertainty of the board's scale, 0.0002 if it is not given.

    No image shows the scale of a board: it is part of the uncertainty of every length that is measured.
    """

    foreground: Reflectance = 0.0
    """Reflectance 0 to 1 of what is printed: circles, dark squares and markers."""

    background: Reflectance = 1.0
    """Reflectance 0 to 1 of the rest of the board."""
