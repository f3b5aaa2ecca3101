"""Printed boards: measured on the page as written, by a reader of our own."""

import json
import re
import zlib
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from fpplab.cli.every import app
from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError, DataError
from fpplab.targets import Target
from fpplab.targets.printing import PrintedSheet, paper_size, print_target
from tests.targets.test_targets import charuco_model

MM = 25.4 / 72
"""A point of PDF and SVG in mm."""
CLOSE = 1e-3
"""mm"""
RULER_AND_TEXT = 26.0
"""Foot of the page in mm in which there is no board."""

BOARDS: dict[str, dict[str, object]] = {
    "staggered": {"kind": "circles", "size_mm": [60, 42], "counts": [13, 4], "spacing_mm": [4.5, 9],
                  "staggered": True, "diameter_mm": 3},
    "symmetric": {"kind": "circles", "size_mm": [120, 90], "counts": [7, 5], "spacing_mm": [15, 15],
                  "diameter_mm": 7},
    "bright": {"kind": "circles", "size_mm": [60, 42], "counts": [13, 4], "spacing_mm": [4.5, 9],
               "staggered": True, "diameter_mm": 3, "foreground": 0.9, "background": 0.1},
    "checkerboard": {"kind": "checkerboard", "size_mm": [100, 80], "counts": [7, 5], "spacing_mm": [10, 10]},
    "charuco": {"kind": "charuco", "size_mm": [160, 120], "counts": [6, 4], "spacing_mm": [20, 20],
                "marker_mm": 14, "dictionary": "4x4_50"},
}  # fmt: skip
KINDS = pytest.mark.parametrize("kind", list(BOARDS))
FORMATS = pytest.mark.parametrize("suffix", [".svg", ".pdf"])

Fill = tuple[float, list[Floats]]
"""Level of grey 0 … 1, and closed outlines (n, 2) in mm from the page's upper left corner, y down."""


def board(kind: str, **changes: object) -> Target:
    return config.validate({**BOARDS[kind], **changes}, Target, "board.yaml")


def outlines(tokens: list[str], words: dict[str, int]) -> list[Floats]:
    """Closed outlines of move, line, curve and close; curves are followed in 32 steps."""
    found: list[list[Floats]] = []
    numbers: list[float] = []
    for token in tokens:
        if token not in words:
            numbers.append(float(token))
            continue
        points = np.array(numbers).reshape(-1, 2)
        assert len(points) == words[token]
        numbers = []
        if token in "mM":
            found.append([points[0]])
        elif token in "lL":
            found[-1].append(points[0])
        elif token in "cC":
            t = np.linspace(0, 1, 33)[1:, None]
            a, (b, c, d) = found[-1][-1], points
            found[-1] += list(a * (1 - t) ** 3 + 3 * b * t * (1 - t) ** 2 + 3 * c * t**2 * (1 - t) + d * t**3)
    return [np.array(outline) for outline in found]


def read_svg(path: Path) -> tuple[Floats, list[Fill]]:
    root = ElementTree.parse(path).getroot()
    size = np.array([float(root.attrib[side].removesuffix("pt")) for side in ("width", "height")])
    assert [float(x) for x in root.attrib["viewBox"].split()] == [0, 0, *size]
    fills = []
    for group in root.iter("{http://www.w3.org/2000/svg}g"):
        if not group.attrib.get("id", "").startswith("patch"):
            continue
        drawn = group.find("{http://www.w3.org/2000/svg}path")
        assert drawn is not None
        style = drawn.attrib.get("style", "")
        colour = re.search(r"fill: #(\w\w)", style)
        level = int(colour.group(1), 16) / 255 if colour else 0.0
        # Between y up and y down a prefix: the words stand after their numbers here.
        tokens = re.findall(r"[MLCz]|[-\d.e]+", drawn.attrib["d"])
        reordered = [part for word in split_words(tokens) for part in (*word[1:], word[0])]
        fills.append((level, [o * MM for o in outlines(reordered, {"M": 1, "L": 1, "C": 3, "z": 0})]))
    return size * MM, fills


def split_words(tokens: list[str]) -> list[list[str]]:
    starts = [i for i, token in enumerate(tokens) if token in "MLCz"]
    return [tokens[a:b] for a, b in zip(starts, [*starts[1:], len(tokens)], strict=True)]


def read_pdf(path: Path) -> tuple[Floats, list[Fill]]:
    content = path.read_bytes()
    box = re.search(rb"/MediaBox \[ ?([-\d. ]+?) ?\]", content)
    assert box is not None
    left, bottom, right, top = (float(x) for x in box.group(1).split())
    assert (left, bottom) == (0, 0)
    streams = [zlib.decompress(s) for s in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", content, re.S)[:1]]
    fills: list[Fill] = []
    level, numbers, drawn = 0.0, [], []
    for token in re.sub(r"\bBT\b.*?\bET\b", "", streams[0].decode("latin-1"), flags=re.S).split():
        if re.fullmatch(r"[-\d.]+", token):
            numbers.append(token)
            continue
        if token in ("g", "rg"):
            level = float(numbers[0])
        elif token in "mlch":
            drawn += [*numbers, token]
        elif token == "f":
            found = outlines(drawn, {"m": 1, "l": 1, "c": 3, "h": 0})
            fills.append((level, [(o * (1, -1) + (0, top)) * MM for o in found]))
            drawn = []
        numbers = []
    return np.array([right, top]) * MM, fills


READERS: dict[str, Callable[[Path], tuple[Floats, list[Fill]]]] = {".svg": read_svg, ".pdf": read_pdf}


def printed(target: Target, path: Path, paper: str = "A4") -> tuple[Floats, list[Fill]]:
    print_target(target, path, paper)
    return READERS[path.suffix](path)


def drawing(fills: list[Fill], level: float) -> list[Floats]:
    """The outlines of the board's own ink, which is drawn in one go: the most of all."""
    return max((found for grey, found in fills if grey == level), key=len)


def centroid(outline: Floats) -> Floats:
    """Of the area, by the shoelace formula; an outline's points are not spread evenly."""
    x, y = outline.T
    p, q = np.roll(outline, -1, axis=0).T
    cross = x * q - p * y
    return np.array([np.sum((x + p) * cross), np.sum((y + q) * cross)]) / (3 * np.sum(cross))


def picture(page: tuple[Floats, list[Fill]], px_per_mm: float) -> np.ndarray:
    """The page as a camera above it sees it, without ruler and text, antialiased."""
    (width, height), fills = page
    fine, shift = 8, 8
    shape = np.rint(np.array([height, width]) * px_per_mm).astype(int)
    sheet = np.full(shape * fine, 255, np.uint8)
    for grey, found in fills:
        corners = [np.rint((o * px_per_mm * fine - 0.5) * 2**shift).astype(np.int32) for o in found]
        for outline in corners:
            cv2.fillPoly(sheet, [outline], (round(255 * grey),), cv2.LINE_8, shift)
    sheet[round((height - RULER_AND_TEXT) * px_per_mm * fine) :] = 255
    return cv2.resize(sheet, tuple(shape[::-1].tolist()), interpolation=cv2.INTER_AREA)


@pytest.mark.whole_after(2)
@FORMATS
@pytest.mark.parametrize("kind", ["staggered", "symmetric", "bright"])
def test_circles_lie_where_the_board_has_them(kind: str, suffix: str, tmp_path: Path) -> None:
    target = board(kind)
    size, fills = printed(target, tmp_path / f"board{suffix}")
    discs = drawing(fills, 1.0 if kind == "bright" else 0.0)
    middles = np.array([centroid(disc) for disc in discs])
    np.testing.assert_allclose(middles, target.points()[:, :2] + size / 2, atol=CLOSE)
    radii = np.concatenate([np.linalg.norm(d - m, axis=1) for d, m in zip(discs, middles, strict=True)])
    np.testing.assert_allclose(radii, (target.diameter_mm or 0) / 2, atol=CLOSE)


@FORMATS
@pytest.mark.parametrize("kind", ["checkerboard", "charuco"])
def test_corners_are_shared_by_two_dark_squares(kind: str, suffix: str, tmp_path: Path) -> None:
    target = board(kind)
    size, fills = printed(target, tmp_path / f"board{suffix}")
    sides = [np.ptp(square, axis=0) for square in drawing(fills, 0.0)]
    squares = [
        s for s, side in zip(drawing(fills, 0.0), sides, strict=True) if side[0] > 0.9 * target.spacing_mm[0]
    ]
    for square in squares:
        np.testing.assert_allclose(np.ptp(square, axis=0), target.spacing_mm, atol=CLOSE)
    corners = np.concatenate([square[:4] for square in squares])
    for point in target.points()[:, :2] + size / 2:
        assert np.sum(np.linalg.norm(corners - point, axis=1) < CLOSE) == 2


@pytest.mark.whole
@FORMATS
def test_markers_are_opencvs_own(suffix: str, tmp_path: Path) -> None:
    target = board("charuco", size_mm=[140, 100])
    page = printed(target, tmp_path / f"board{suffix}")
    seen = picture(page, 10.0)
    top, left = (seen.shape[0] - 1000) // 2, (seen.shape[1] - 1400) // 2
    expected = charuco_model(target).generateImage((1400, 1000), marginSize=0)
    cut = seen[top : top + 1000, left : left + 1400]
    # Rims of a pixel apart, which are rounded.
    assert np.mean(np.abs(cut.astype(int) - expected) > 128) < 0.004


@pytest.mark.whole_after(1)
@FORMATS
@KINDS
def test_our_detector_finds_what_is_printed_where_it_is_meant(kind: str, suffix: str, tmp_path: Path) -> None:
    target, px_per_mm = board(kind), 5.0
    page = printed(target, tmp_path / f"board{suffix}")
    found = target.detect(cv2.GaussianBlur(picture(page, px_per_mm), (0, 0), 0.8))
    assert found is not None
    assert len(found.ids) == len(target.points())
    expected = (target.points()[found.ids, :2] + page[0] / 2) * px_per_mm - 0.5
    if target.symmetric:
        expected = min(expected, expected[::-1], key=lambda e: float(np.abs(e - found.pixels).max()))
    np.testing.assert_allclose(
        found.pixels, expected, atol=0.1
    )  # px of 0.2 mm, of which the raster knows an eighth


@FORMATS
def test_the_ruler_is_100_mm_long(suffix: str, tmp_path: Path) -> None:
    size, fills = printed(board("staggered"), tmp_path / f"board{suffix}")
    lines = [o for grey, found in fills if grey == 0 for o in found if len(found) == 1 and len(o) <= 5]
    sides = np.array([np.ptp(line, axis=0) for line in lines])
    middles = np.array([0.5 * (line.min(axis=0) + line.max(axis=0)) for line in lines])
    ruler = int(np.argmax(sides[:, 0]))
    np.testing.assert_allclose(sides[ruler], [100, 0.2], atol=CLOSE)
    marks = np.sort(
        middles[(np.abs(sides[:, 0] - 0.15) < CLOSE) & (middles[:, 1] > size[1] - RULER_AND_TEXT), 0]
    )
    np.testing.assert_allclose(marks, middles[ruler, 0] - 50 + np.arange(101), atol=CLOSE)


@KINDS
def test_cutting_marks_point_at_the_boards_corners_and_stay_outside(kind: str, tmp_path: Path) -> None:
    target = board(kind)
    size, fills = printed(target, tmp_path / "board.svg")
    half = 0.5 * np.array(target.size_mm)
    lines = [found[0] - size / 2 for _, found in fills if len(found) == 1 and len(found[0]) <= 5]
    lines = [line for line in lines if line[0, 1] < size[1] / 2 - RULER_AND_TEXT]
    middles = np.array([0.5 * (line.min(axis=0) + line.max(axis=0)) for line in lines])
    on_edge = np.isclose(np.abs(middles), half, atol=CLOSE)
    marks = [line for line, edge in zip(lines, on_edge, strict=True) if edge.sum() == 1]
    assert len(marks) == 8
    for mark in marks:
        assert np.all((np.abs(mark) >= half + 2.9).any(axis=1))


@pytest.mark.whole_after(2)
@FORMATS
@pytest.mark.parametrize(
    ("paper", "expected"),
    [("A4", (210, 297)), ("a3", (297, 420)), ("letter", (215.9, 279.4)), ("180x150mm", (180, 150))],
)
def test_the_page_has_the_papers_size(
    paper: str, expected: tuple[float, float], suffix: str, tmp_path: Path
) -> None:
    path = tmp_path / f"board{suffix}"
    assert print_target(board("staggered"), path, paper) == PrintedSheet(path, expected, 1.0)
    np.testing.assert_allclose(READERS[suffix](path)[0], expected, atol=CLOSE)


def test_paper_is_turned_for_a_wide_board(tmp_path: Path) -> None:
    wide = board("checkerboard", size_mm=[240, 80])
    assert print_target(wide, tmp_path / "board.pdf").paper_mm == (297, 210)
    with pytest.raises(ConfigError, match="is 210 x 297 mm but"):
        print_target(wide, tmp_path / "board.svg", "210x297")  # a size that is spelt out is meant so
    assert not (tmp_path / "board.svg").exists()


def test_a_board_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"--paper A4 is 210 x 297 mm but a board of 400 x 80 mm .*larger paper"
    ):
        print_target(board("checkerboard", size_mm=[400, 80]), tmp_path / "board.pdf")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("paper", ["A5x", "200", "0x10", "-3x4", "nanx4", "200x200x3", "1e9x3", ""])
def test_paper_that_is_none_is_refused(paper: str) -> None:
    with pytest.raises(ConfigError, match="--paper is"):
        paper_size(paper)


def test_a_raster_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"\.pdf or \.svg"):
        print_target(board("staggered"), tmp_path / "board.png")


def test_a_place_that_cannot_be_written_is_a_data_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        print_target(board("staggered"), tmp_path / "file" / "board.pdf")


@FORMATS
def test_the_same_board_gives_the_same_file(suffix: str, tmp_path: Path) -> None:
    pages = [tmp_path / f"{i}{suffix}" for i in range(2)]
    for page in pages:
        print_target(board("charuco"), page)
    assert pages[0].read_bytes() == pages[1].read_bytes()


def test_the_page_says_what_it_is(tmp_path: Path) -> None:
    print_target(board("staggered"), tmp_path / "board.svg", legend_name="target $x_1$ <&>")
    words = " ".join(re.findall(r"<!-- (.*?) -->", (tmp_path / "board.svg").read_text()))
    assert "13 x 4 circles of 3 mm, staggered, pitch 4.5 x 9 mm, board 60 x 42 mm." in words
    assert "Print at 100 %, then measure the ruler" in words


# The command


def run(*words: object) -> Result:
    return CliRunner().invoke(app, ["target", *map(str, words)])


def test_reference_marks_have_a_short_name(tmp_path: Path) -> None:
    assert run("marks", "--out", tmp_path / "marks.svg").exit_code == 0
    assert (tmp_path / "marks.svg").is_file()


@pytest.mark.whole_after(2)
@pytest.mark.parametrize("name", ["target_paper", "target_slstudio", "target_charuco", "target_checkerboard"])
@FORMATS
def test_every_board_that_comes_with_fpplab_fits_a4(name: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"board{suffix}"
    result = run(name, "--out", path, "--json")
    assert result.exit_code == 0
    paper = [210.0, 297.0]
    assert json.loads(result.stdout) == {"file": str(path), "paper_mm": paper, "scale": 1.0}
    np.testing.assert_allclose(READERS[suffix](path)[0], paper, atol=CLOSE)


def test_a_page_is_not_overwritten_by_accident(tmp_path: Path) -> None:
    path = tmp_path / "board.pdf"
    path.write_text("mine")
    assert isinstance(run("target_paper", "--make", path).exception, ConfigError)
    assert path.read_text() == "mine"
    assert run("target_paper", "--make", path, "--force").exit_code == 0
    assert path.read_bytes().startswith(b"%PDF")
