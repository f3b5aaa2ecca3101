"""Boards on paper: one page at true scale in mm, y up, with marks to cut it out and a ruler to verify it."""

import textwrap
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.transforms import Affine2D

from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError
from fpplab.core.files import need_suffix, write_atomic
from fpplab.core.units import MM_PER_INCH
from fpplab.targets.drawing import InkDisc, InkShape
from fpplab.targets.target import Target

PAPERS = {"A4": (210.0, 297.0), "A3": (297.0, 420.0), "letter": (215.9, 279.4)}
_KNOWN = {name.lower(): size for name, size in PAPERS.items()}


@dataclass(frozen=True)
class SheetLayout:
    """Sizes on a printed sheet, all chosen."""

    margin_mm: float = 6.0  # margin of the paper that printers cannot print on
    legend_mm: float = 17.0  # height of ruler and text together, above the margin
    ruler_mm: float = 100.0  # length of the ruler
    mark_mm: float = 3.0  # length of a cutting mark, and its distance from the board
    letter_mm: float = 2.0  # height of a capital letter
    letter_advance: float = 0.9  # mean width of a letter with some reserve, in heights of a capital
    max_name_letters: int = 40  # letters of a board's name that are printed


LAYOUT = SheetLayout()


@dataclass(frozen=True)
class PrintedSheet:
    """A page as written."""

    file: Path  # the file
    paper_mm: tuple[float, float]  # (width, height) in mm
    scale: float = 1.0  # mm on paper for each mm of the board


def paper_size(name: str) -> tuple[float, float]:
    # returns (width, height) mm
    if name.lower() in _KNOWN:
        return _KNOWN[name.lower()]
    try:
        width, height = (float(part) for part in name.lower().removesuffix("mm").split("x"))
    except ValueError:
        raise ConfigError(
            f"--paper is '{name}'; give {', '.join(PAPERS)}, or width x height in mm like 300x200"
        ) from None
    if not (0 < width <= 5000 and 0 < height <= 5000):
        raise ConfigError(f"--paper is '{name}'; width and height must be over 0 and at most 5000 mm")
    return width, height


def print_target(
    target: Target, page_file: Path, paper: str = "A4", legend_name: str = "board"
) -> PrintedSheet:
    need_suffix(page_file, ".pdf", ".svg")
    size = _paper_size_turned_to_fit(target, paper)
    page = _Page(size)
    page.board(target)
    page.ruler()
    page.write_legend(_legend(target, legend_name))
    kind = page_file.suffix.lower().removeprefix(".")
    unstamped = {"CreationDate": None} if kind == "pdf" else {"Date": None}
    with rc_context({"svg.hashsalt": "fpplab", "pdf.fonttype": 42}):
        write_atomic(page_file, lambda out: page.figure.savefig(out, format=kind, metadata=unstamped))
    return PrintedSheet(page_file, size)


def ink(target: Target) -> Outline:
    # It is one outline, so that no hairline shows where two squares of a marker meet.
    # returns (x right, y down)
    return Outline.make_compound_path(*(_outline(shape) for shape in target.layout.shapes()))


def _outline(shape: InkShape) -> Outline:
    if isinstance(shape, InkDisc):
        disc = Outline.circle(radius=shape.radius)
        return disc.transformed(Affine2D().translate(shape.x, shape.y))
    return _box(*shape)


def _box(left: float, top: float, right: float, bottom: float) -> Outline:
    corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]
    return Outline(corners, closed=True)


def _paper_size_turned_to_fit(target: Target, paper: str) -> tuple[float, float]:
    width, height = paper_size(paper)
    needed = _paper_size_needed(target)
    ways = [(width, height)]
    if paper.lower() in _KNOWN:
        ways.append((height, width))
    for way in ways:
        if way[0] >= needed[0] and way[1] >= needed[1]:
            return way
    raise ConfigError(
        f"--paper {paper} is {width:g} x {height:g} mm but a board of {target.size_mm[0]:g} x "
        f"{target.size_mm[1]:g} mm with its ruler and text needs {needed[0]:g} x {needed[1]:g} mm; "
        f"take larger paper"
    )


def _paper_size_needed(target: Target) -> tuple[float, float]:
    """Return the least paper size: the legend is below a board that is at the page's centre."""
    width, height = target.size_mm
    marked = width + 2 * (LAYOUT.margin_mm + 2 * LAYOUT.mark_mm)
    across = max(marked, LAYOUT.ruler_mm + 2 * LAYOUT.margin_mm + 8)
    return across, height + 2 * (LAYOUT.margin_mm + LAYOUT.legend_mm + 2 * LAYOUT.mark_mm)


def _legend(target: Target, name: str) -> str:
    width, height = target.size_mm
    return (
        f"{name[: LAYOUT.max_name_letters]}: {target.layout.summary()}, board {width:g} x {height:g} mm. "
        f"Print at 100 %, then measure the ruler: it must be {LAYOUT.ruler_mm:g} mm long."
    )


class _Page:
    """A page in mm, y up."""

    def __init__(self, size: tuple[float, float]) -> None:
        self.size = size
        self.figure = Figure(figsize=(size[0] / MM_PER_INCH, size[1] / MM_PER_INCH), frameon=False)
        self._mm = Affine2D().scale(1 / MM_PER_INCH) + self.figure.dpi_scale_trans

    def fill(self, outline: Outline, colour: str) -> None:
        patch = PathPatch(outline, facecolor=colour, edgecolor="none", linewidth=0, transform=self._mm)
        self.figure.add_artist(patch)

    def board(self, target: Target) -> None:
        middle = Affine2D().scale(1, -1).translate(self.size[0] / 2, self.size[1] / 2)
        width, height = target.size_mm
        sheet = _box(-width / 2, -height / 2, width / 2, height / 2)
        bright = target.foreground > target.background
        if bright:
            self.fill(middle.transform_path(sheet), "black")
        self.fill(middle.transform_path(ink(target)), "white" if bright else "black")
        for x in (-width / 2, width / 2):
            for y in (-height / 2, height / 2):
                corner = middle.transform((x, y))
                self.cutting_mark(corner, np.sign([x, -y]))

    def cutting_mark(self, corner: Floats, outwards: Floats) -> None:
        for axis in np.eye(2):
            step = axis * outwards
            self.line(corner + LAYOUT.mark_mm * step, corner + 2 * LAYOUT.mark_mm * step, 0.15)

    def line(self, start: Floats, end: Floats, width_mm: float) -> None:
        """Draw a straight line as a rectangle, so that its ends are exactly where they are given."""
        along = (end - start) / np.linalg.norm(end - start)
        side = 0.5 * width_mm * np.array([-along[1], along[0]])
        corners = [start + side, end + side, end - side, start - side, start + side]
        self.fill(Outline(corners, closed=True), "black")

    def ruler(self) -> None:
        left, foot = 0.5 * (self.size[0] - LAYOUT.ruler_mm), LAYOUT.margin_mm + LAYOUT.legend_mm - 6
        start = np.array([left, foot], np.float64)
        self.line(start, start + (LAYOUT.ruler_mm, 0), 0.2)
        for mm in range(int(LAYOUT.ruler_mm) + 1):
            height = 3.0 if mm % 10 == 0 else 2.2 if mm % 5 == 0 else 1.5
            self.line(start + (mm, 0), start + (mm, height), 0.15)
            if mm % 50 == 0:
                unit = " mm" if mm == LAYOUT.ruler_mm else ""
                self.text(left + mm, foot + 3.4, f"{mm}{unit}")

    def write_legend(self, legend: str) -> None:
        max_letters = int((self.size[0] - 2 * LAYOUT.margin_mm) / (LAYOUT.letter_advance * LAYOUT.letter_mm))
        top = LAYOUT.margin_mm + LAYOUT.legend_mm - 10
        for row, line in enumerate(textwrap.wrap(legend, max_letters)):
            self.text(self.size[0] / 2, top - 1.3 * LAYOUT.letter_mm * row, line)

    def text(self, x: float, y: float, content: str) -> None:
        size = LAYOUT.letter_mm * (72.0 / MM_PER_INCH) / 0.75  # of the font, whose capitals are 3/4 as high
        self.figure.text(
            x, y, content, ha="center", va="baseline", fontsize=size, transform=self._mm, parse_math=False
        )
