"""How every picture of the report is drawn: the house style, sheets and axes, maps with their colour bars."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image as Pixels

from fpplab.core.conventions import Map
from fpplab.core.errors import DataError
from fpplab.report.raster import Extent

HALF, FULL = 4.8, 9.6
"""Widths in inches of pictures that stand in pairs, and alone."""
DPI = 160
FINEST = 1200
"""Columns beyond which a map is thinned before it is drawn."""
UNMEASURED = "#b9bcc0"
INK, ACCENT, SECOND, ALARM = "#22262b", "#1f6f9f", "#c0662b", "#ff3b1f"
STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#6c727a",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": "#4a5058",
    "ytick.color": "#4a5058",
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
}

P = ParamSpec("P")


def picture(draw: Callable[P, Figure]) -> Callable[P, bytes]:
    """Draw in the house style and return the PNG file."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> bytes:
        with mpl.rc_context(cast(Any, STYLE)):
            return _png(draw(*args, **kwargs))

    return drawn


def _png(figure: Figure) -> bytes:
    """A PNG of 256 colours: a third of the size, which is what a page of many pictures needs."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    rgb = Pixels.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    stream = io.BytesIO()
    rgb.quantize(256, dither=Pixels.Dither.NONE).save(stream, "PNG", optimize=True)
    return stream.getvalue()


def blank(width: float, height: float) -> Figure:
    """An empty sheet, in inches. Axes are laid on it by `subplots` or `add_gridspec`."""
    return Figure(figsize=(width, height), dpi=DPI, layout="compressed", facecolor="white")


def sheet(width: float, height: float) -> tuple[Figure, Axes]:
    """A sheet, in inches, with one pair of axes."""
    figure = blank(width, height)
    return figure, figure.subplots()


def pair(height: float, ratios: tuple[float, float]) -> tuple[Figure, tuple[Axes, Axes]]:
    """A sheet of full width, `height` in inches, with axes side by side whose widths are as `ratios`."""
    figure = blank(FULL, height)
    cast(Any, figure.get_layout_engine()).set(wspace=0.05)
    left, right = figure.subplots(1, 2, width_ratios=ratios)
    return figure, (left, right)


def map_sheet(shape: tuple[int, ...]) -> tuple[Figure, Axes]:
    """A sheet of half width for a map of `shape` (h, w)."""
    return sheet(HALF, map_height(shape, HALF))


def map_height(shape: tuple[int, ...], width: float) -> float:
    """Height of a picture whose map, of `shape` (h, w), leaves room for labels; never a tower."""
    return float(np.clip((width - 1.1) * shape[0] / shape[1] + 0.7, 1.8, 1.25 * width))


def sensor_axes(axes: Axes, size: tuple[int, int], device: str) -> None:
    """The whole sensor of a `device` of size (width, height) in px, its first pixel at the upper left."""
    axes.set(
        xlim=(-0.5, size[0] - 0.5),
        ylim=(size[1] - 0.5, -0.5),
        aspect="equal",
        xlabel=f"{device} u in px",
        ylabel=f"{device} v in px",
    )


def show(
    axes: Axes,
    values: NDArray[Any],
    colours: str | mpl.colors.Colormap,
    limits: tuple[float, float],
    extent: Extent | None = None,
    background: bool = True,
) -> ScalarMappable:
    """Draw a map [v, u], NaN where not measured, thinned to about `FINEST` columns.

    limits: of the colours. extent: left, right, bottom and top edge in the units of the axes; the camera's
    pixels by default. background: colour what is not measured, and name the axes the camera's.
    """
    height, width = values.shape
    step = thinning(values.shape)
    if background:
        axes.set_facecolor(UNMEASURED)
        axes.set(xlabel="camera u in px", ylabel="camera v in px")
    return axes.imshow(
        values[::step, ::step],
        cmap=colours,
        vmin=limits[0],
        vmax=limits[1],
        extent=extent or (-0.5, width - 0.5, height - 0.5, -0.5),
    )


def colour_bar(figure: Figure, axes: Axes, mappable: ScalarMappable, label: str) -> mpl.colorbar.Colorbar:
    """The house's colour bar beside `axes`."""
    bar = figure.colorbar(mappable, ax=axes, label=label, fraction=0.05, pad=0.02, aspect=28)
    bar.outline.set_visible(False)
    return bar


def thinning(shape: tuple[int, ...]) -> int:
    """Every how many columns of a map of `shape` (h, w) are drawn."""
    return max(1, -(-shape[1] // FINEST))


def value_range(values: Map, least: float, most: float) -> tuple[float, float]:
    """Two percentiles of what is measured, the second never below the first.

    Raises `DataError` when nothing is measured.
    """
    known = values[np.isfinite(values)]
    if not len(known):
        raise DataError("the map has no measured pixel; nothing to draw")
    low, high = np.percentile(known, (least, most))
    return float(low), float(max(high, low + 1e-6))
