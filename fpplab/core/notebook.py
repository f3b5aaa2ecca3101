"""What objects show in a notebook: tables as HTML, small pictures, and axes to draw into."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CUT = (2.0, 98.0)  # percentiles of the values that are drawn black and white


def html_table(title: str, rows: Mapping[str, object], picture: bytes | None = None) -> str:
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th>"
        f"<td style='text-align:left'>{escape(str(value))}</td></tr>"
        for name, value in rows.items()
        if value is not None
    )
    table = f"<table><caption><b>{escape(title)}</b></caption>{cells}</table>"
    if picture is None:
        return f"<div>{table}</div>"
    data = base64.b64encode(picture).decode("ascii")
    image = (
        f"<img alt='{escape(title, quote=True)}' style='max-width:100%' src='data:image/png;base64,{data}'/>"
    )
    return f"<div style='display:flex;flex-wrap:wrap;align-items:flex-start;gap:1em'>{table}{image}</div>"


def grey_picture(values: NDArray[Any], max_px: int = 240) -> bytes:
    # values (height, width)
    from PIL import Image as Pixels

    step = max(1, -(-max(values.shape) // max_px))
    shown = np.asarray(values[::step, ::step], np.float64)
    finite = np.isfinite(shown)
    low, high = np.percentile(shown[finite], CUT) if finite.any() else (0.0, 1.0)
    share = np.clip((np.where(finite, shown, low) - low) / max(high - low, 1e-12), 0.0, 1.0)
    layers = np.stack([np.rint(255 * share), 255.0 * finite], axis=-1).astype(np.uint8)
    stream = io.BytesIO()
    Pixels.fromarray(layers, "LA").save(stream, "PNG")
    return stream.getvalue()


def axes_or_new(axes: Axes | None) -> Axes:
    if axes is not None:
        return axes
    from matplotlib import pyplot as plt

    return plt.subplots(layout="constrained")[1]


def plot_map(values: NDArray[Any], label: str, axes: Axes | None = None) -> Axes:
    # values (height, width)
    chosen = axes_or_new(axes)
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, CUT) if finite.size else (0.0, 1.0)
    image = chosen.imshow(values, vmin=float(low), vmax=float(high), interpolation="nearest")
    chosen.figure.colorbar(image, ax=chosen, label=label)
    chosen.set(xlabel="camera column, px", ylabel="camera row, px")
    return chosen
