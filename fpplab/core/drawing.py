"""Common style and helpers of all figures. Matplotlib is loaded only where one is drawn."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import wraps
from typing import TYPE_CHECKING, Any, ParamSpec, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Image, full_scale

if TYPE_CHECKING:
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

HALF, FULL = 4.8, 9.6  # widths in inches of figures in two columns, and of the full page
MAX_COLUMNS = 1200  # columns beyond which a map is subsampled before it is drawn (chosen)
UNMEASURED = "#b9bcc0"
"""Colour of what was not measured."""
ERROR_COLOURS = "RdBu_r"  # colour map of signed errors: negative is blue, positive red
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


def as_png(draw: Callable[P, Figure]) -> Callable[P, bytes]:
    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> bytes:
        with common_style():
            return encode_png(draw(*args, **kwargs))

    return drawn


def common_style() -> AbstractContextManager[None]:
    from matplotlib import rc_context

    return rc_context(cast(Any, STYLE))


def encode_png(figure: Figure) -> bytes:
    """Encode as PNG of 256 colours: a third of the size, for pages of many figures."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image as Pixels

    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    rgb = Pixels.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    stream = io.BytesIO()
    # level 9, or `optimize`, takes four times as long for 3 % less
    rgb.quantize(256, dither=Pixels.Dither.NONE).save(stream, "PNG", compress_level=7)
    return stream.getvalue()


def new_figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=144, layout="compressed", facecolor="white")


def single_axes(width: float, height: float) -> tuple[Figure, Axes]:
    figure = new_figure(width, height)
    return figure, figure.subplots()


def side_by_side(height: float, ratios: tuple[float, float]) -> tuple[Figure, tuple[Axes, Axes]]:
    figure = new_figure(FULL, height)
    cast(Any, figure.get_layout_engine()).set(wspace=0.05)
    left, right = figure.subplots(1, 2, width_ratios=ratios)
    return figure, (left, right)


def map_axes(shape: tuple[int, ...]) -> tuple[Figure, Axes]:
    # shape (h, w)
    return single_axes(HALF, map_height(shape, HALF))


def map_height(shape: tuple[int, ...], width: float) -> float:
    """Compute the height of a figure for a map, with room for labels; limited to 1.25 of the width."""
    # shape (h, w)
    return float(np.clip((width - 1.1) * shape[0] / shape[1] + 0.7, 1.8, 1.25 * width))


def sensor_axes(axes: Axes, size: tuple[int, int], device: str) -> None:
    axes.set(
        xlim=(-0.5, size[0] - 0.5),
        ylim=(size[1] - 0.5, -0.5),
        aspect="equal",
        xlabel=f"{device} u in px",
        ylabel=f"{device} v in px",
    )


def name_poses(axes: Axes, names: Sequence[str]) -> None:
    """Write the names of poses below an axis, rotated where they are more than eight."""
    rotated = len(names) > 8
    places = np.arange(len(names))
    axes.set_xticks(places, names, rotation=35 if rotated else 0, ha="right" if rotated else "center")
    axes.set_xlim(-0.6, len(names) - 0.4)


def draw_map(
    axes: Axes,
    values: NDArray[Any],
    colours: str | mpl.colors.Colormap,
    limits: tuple[float, float],
    extent: tuple[float, float, float, float] | None = None,
    background: bool = True,
) -> ScalarMappable:
    # extent (left, right, bottom, top) in px
    height, width = values.shape
    step = display_stride(values.shape)
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


def draw_frame(image: Image, bits: int = 8) -> Figure:
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    full = full_scale(bits)
    saturated = image >= full
    figure, axes = map_axes(image.shape)
    step = display_stride(image.shape)
    bright = max(float(np.percentile(image[::step, ::step], 99.8)), 1.0)
    mappable = draw_map(axes, image, "gray", (0.0, bright))
    share = float(saturated.mean())
    label = f"{saturated.sum():,} saturated pixels ({100 * share:.2g} %)" if share else "no saturated pixels"
    if share:
        marks = cv2.dilate(saturated.astype(np.uint8), np.ones((2 * step + 1,) * 2, np.uint8)) > 0
        overlay = np.where(marks, 1.0, np.nan)
        draw_map(axes, overlay, ListedColormap([ALARM]), (0.0, 1.0), background=False)
    axes.legend(
        handles=[Patch(facecolor=ALARM if share else "none", label=label)],
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        borderpad=0.1,
        handlelength=1.0 if share else 0.0,
    )
    colour_bar(figure, axes, mappable, f"grey level (full scale {full})")
    return figure


def colour_bar(figure: Figure, axes: Axes, mappable: ScalarMappable, label: str) -> mpl.colorbar.Colorbar:
    bar = figure.colorbar(mappable, ax=axes, label=label, fraction=0.05, pad=0.02, aspect=28)
    bar.outline.set_visible(False)
    return bar


def display_stride(shape: tuple[int, ...]) -> int:
    # shape (h, w)
    return max(1, -(-shape[1] // MAX_COLUMNS))
