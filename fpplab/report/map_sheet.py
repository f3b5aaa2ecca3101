"""Maps as PNG files, made pixel by pixel: twenty times as fast as figures, which have to be laid out."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pixels
from PIL import ImageDraw, ImageFont

from fpplab.core.conventions import Floats, Map, Mask
from fpplab.report.raster import Extent

_Indices = NDArray[np.uint8]
"""Picture (h, w) of colours of the palette."""

COLOURS = 224  # of the palette are the map's
UNMEASURED, MARKED, WHITE, INKS = 224, 225, 240, 15
"""The others: what was not measured, what is marked, and shades of text from white to ink."""
RESERVED = {UNMEASURED: (0xB9, 0xBC, 0xC0), MARKED: (0xFF, 0x3B, 0x1F)}
INK = np.array([0x22, 0x26, 0x2B])
TABLES = {
    "viridis": cv2.COLORMAP_VIRIDIS,
    "cividis": cv2.COLORMAP_CIVIDIS,
    "inferno": cv2.COLORMAP_INFERNO,
    "twilight": cv2.COLORMAP_TWILIGHT,
}
MAP_PX, SMALLEST_PX = 600, 300  # greatest and least width of a map in px (chosen): twice that of the page
LARGE, SMALL = 17, 15  # heights of letters in px, for widths of 700 px
LEFT, BELOW, ABOVE, GAP, BAR, TICKS = 70, 48, 12, 10, 14, 74  # room around a map in px, and of its colour bar
LINE = LARGE + 5


@dataclass(frozen=True, eq=False)
class MapSheet:
    """A map with what stands around it."""

    values: Map  # (h, w), NaN where nothing was measured
    colours: str  # of `TABLES`, or `gray`; with `_r` behind it the other way round
    limits: tuple[float, float]  # values of the first and the last colour
    label: str = ""  # of the colour bar; without one there is none
    extent: Extent | None = None  # in units of the axes; by default pixels
    axes: tuple[str, str] | None = ("camera u in px", "camera v in px")
    title: tuple[str, ...] = ()  # lines above the map
    marked: Mask | None = None  # (h, w) pixels in the alarm's colour
    contours: Sequence[float] = ()  # values that are drawn as lines
    ticks: Sequence[tuple[float, str]] = ()  # of the colour bar, in place of round numbers


def drawn_pixels(values: NDArray[Any]) -> NDArray[Any]:
    """Take of an image those pixels that its map shows."""
    step = max(1, -(-values.shape[1] // MAP_PX))
    return values[::step, ::step]


def draw_maps(*sheets: MapSheet) -> bytes:
    """Draw maps of the same size and colours in rows of two."""
    canvases = [_draw(sheet) for sheet in sheets]
    if len(canvases) > 1 and len(canvases) % 2:
        canvases.append(np.full_like(canvases[0], WHITE))
    rows = [np.hstack(canvases[k : k + 2]) for k in range(0, len(canvases), 2)]
    picture = Pixels.fromarray(np.vstack(rows), "P")
    picture.putpalette(_palette(sheets[0].colours).tobytes())
    return _as_png(picture)


def _as_png(picture: Pixels.Image) -> bytes:
    stream = io.BytesIO()
    picture.save(stream, "PNG", compress_level=3)  # of six half the time, and 2 % more bytes
    return stream.getvalue()


def draw_picture(picture: Floats, colours: str, limits: tuple[float, float], label: str) -> bytes:
    """Draw a picture (h, w, 3) of colours from 0 to 1 with a colour bar."""
    side = np.full((len(picture), GAP + BAR + TICKS + LINE), WHITE, np.uint8)
    text, bar = _Text(side), MapSheet(np.empty((1, 1), np.float32), colours, limits, label)
    _draw_bar(bar, side, text, (GAP, ABOVE), len(picture) - 2 * ABOVE)
    text.apply()
    whole = np.hstack([np.rint(255 * picture).astype(np.uint8), _palette(colours)[side]])
    few = Pixels.fromarray(whole).quantize(256, Pixels.Quantize.FASTOCTREE, dither=Pixels.Dither.NONE)
    return _as_png(few)


def colour_table(name: str, count: int = 256) -> NDArray[np.uint8]:
    """Give the colours (count, 3) of a map, as matplotlib has them under this name."""
    share, plain = np.rint(np.linspace(0, 255, count)).astype(np.uint8)[:, None], name.removesuffix("_r")
    if plain == "gray":
        colours = np.repeat(share, 3, axis=1)
    elif plain in TABLES:
        colours = cv2.applyColorMap(share, TABLES[plain])[:, 0, ::-1]
    else:
        import matplotlib as mpl

        return np.asarray(mpl.colormaps[name](share[:, 0], bytes=True)[:, :3], np.uint8)
    return np.asarray(colours[::-1] if name.endswith("_r") else colours)


def _palette(colours: str) -> NDArray[np.uint8]:
    palette = np.full((256, 3), 255, np.uint8)
    palette[:COLOURS] = colour_table(colours, COLOURS)
    for place, colour in RESERVED.items():
        palette[place] = colour
    palette[WHITE:] = 255 + np.linspace(0, 1, INKS + 1)[:, None] * (INK - 255.0)
    return palette


def _draw(sheet: MapSheet) -> _Indices:
    body = _map_body(sheet)
    height, width = body.shape
    left, below = (LEFT, BELOW) if sheet.axes else (0, 0)
    top = ABOVE + LINE * len(sheet.title)
    right = GAP + BAR + TICKS + LINE if sheet.label else GAP
    canvas = np.full((top + height + below + (0 if below else GAP), left + width + right), WHITE, np.uint8)
    canvas[top : top + height, left : left + width] = body
    text = _Text(canvas)
    for k, line in enumerate(sheet.title):
        text.write((left + width // 2, ABOVE + LINE * k - 4), line, "ma")
    if sheet.axes:
        edges = sheet.extent or (-0.5, sheet.values.shape[1] - 0.5, sheet.values.shape[0] - 0.5, -0.5)
        bottom = top + height
        for value, name in round_ticks(edges[0], edges[1], width // 90):
            at = left + round((value - edges[0]) / (edges[1] - edges[0]) * width)
            text.line((at, bottom, at, bottom + 5))
            text.write((at, bottom + 7), name, "ma", SMALL)
        for value, name in round_ticks(edges[3], edges[2], height // 60):
            at = top + round((value - edges[3]) / (edges[2] - edges[3]) * height)
            text.line((left - 5, at, left, at))
            text.write((left - 8, at), name, "rm", SMALL)
        text.write((left + width // 2, bottom + 26), sheet.axes[0], "ma")
        text.write_upwards((0, top + height // 2), sheet.axes[1])
    if sheet.label:
        _draw_bar(sheet, canvas, text, (left + width + GAP, top), height)
    text.apply()
    return canvas


def _draw_bar(sheet: MapSheet, canvas: _Indices, text: "_Text", place: tuple[int, int], height: int) -> None:
    left, top = place
    bar = np.linspace(COLOURS - 1, 0, height).astype(np.uint8)
    canvas[top : top + height, left : left + BAR] = bar[:, None]
    low, high = sheet.limits
    for value in sheet.contours:
        canvas[top + round((high - value) / (high - low) * (height - 1)), left : left + BAR] = WHITE
    for value, name in sheet.ticks or round_ticks(low, high, height // 60):
        at = top + round((high - value) / (high - low) * (height - 1))
        text.line((left + BAR, at, left + BAR + 4, at))
        text.write((left + BAR + 7, at), name, "lm", SMALL)
    text.write_upwards((canvas.shape[1] - LINE, top + height // 2), sheet.label)


def _map_body(sheet: MapSheet) -> _Indices:
    values = drawn_pixels(sheet.values)
    low, high = sheet.limits
    with np.errstate(invalid="ignore"):
        share = np.clip((values - low) * (COLOURS / max(high - low, 1e-12)), 0, COLOURS - 1)
    body = np.where(np.isfinite(values), np.nan_to_num(share), UNMEASURED).astype(np.uint8)
    if len(sheet.contours):
        steps = np.digitize(np.nan_to_num(values), sheet.contours)
        known = np.isfinite(values)
        body[:-1][(steps[:-1] != steps[1:]) & known[:-1] & known[1:]] = WHITE
        across = (steps[:, :-1] != steps[:, 1:]) & known[:, :-1] & known[:, 1:]
        body[:, :-1][across] = WHITE
    if sheet.marked is not None:
        body[drawn_pixels(sheet.marked)] = MARKED
    height, width = body.shape
    larger = max(1, -(-SMALLEST_PX // width))
    size = (width * larger, int(np.clip(height * larger, 60, 1.25 * max(width * larger, SMALLEST_PX))))
    return (
        body
        if size == (width, height)
        else np.asarray(cv2.resize(body, size, interpolation=cv2.INTER_NEAREST))
    )


class _Text:
    """Words and lines that are put over a canvas together."""

    def __init__(self, canvas: _Indices) -> None:
        self._canvas = canvas
        self._layer = Pixels.new("L", (canvas.shape[1], canvas.shape[0]), 0)
        self._draw = ImageDraw.Draw(self._layer)

    def write(self, place: tuple[int, int], text: str, anchor: str, height: int = LARGE) -> None:
        self._draw.text(place, text, fill=255, font=label_font(height), anchor=anchor)

    def write_upwards(self, place: tuple[int, int], text: str) -> None:
        strip = Pixels.new("L", (int(label_font(LARGE).getlength(text)) + 2, LINE), 0)
        ImageDraw.Draw(strip).text((0, LINE // 2), text, fill=255, font=label_font(LARGE), anchor="lm")
        turned = strip.rotate(90, expand=True)
        self._layer.paste(turned, (place[0], max(0, place[1] - turned.height // 2)))

    def line(self, ends: tuple[int, int, int, int]) -> None:
        self._draw.line(ends, fill=200)

    def apply(self) -> None:
        layer = np.asarray(self._layer)
        inked = layer > 0
        self._canvas[inked] = WHITE + layer[inked] // 17


@cache
def label_font(height: int) -> ImageFont.FreeTypeFont:
    """The figures' font, which comes with matplotlib: to import that takes longer than to draw the maps."""
    package = find_spec("matplotlib")
    folder = Path(str(package.origin)).parent if package else Path()
    return ImageFont.truetype(str(folder / "mpl-data/fonts/ttf/DejaVuSans.ttf"), height)


def round_ticks(low: float, high: float, count: int) -> list[tuple[float, str]]:
    """Choose round numbers in an interval, about so many."""
    rough = (high - low) / max(count, 2)
    scale = 10.0 ** np.floor(np.log10(rough))
    step = scale * next(factor for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if factor * scale >= rough)
    values = step * np.arange(np.ceil(low / step), np.floor(high / step) + 1) + 0.0
    digits = max(0, -int(np.floor(np.log10(step) + 1e-9)) + (step / scale == 2.5))
    return [(float(value), f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")) for value in values]
