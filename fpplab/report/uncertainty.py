"""How well the points of a scan are known: maps of noise, of the calibration's part, and of what bends."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from matplotlib.figure import Figure

from fpplab.clouds import Cloud
from fpplab.core.errors import DataError
from fpplab.report.drawing import FULL, HALF, blank, colour_bar, map_height, picture, show, value_range
from fpplab.report.raster import lay, raster

PARTS = {
    "sigma_noise_mm": "noise",
    "sigma_calibration_mm": "calibration",
    "sigma_form_mm": "calibration, rigid motion taken off",
}
"""What a cloud may say of its points, and how a picture calls it."""


@picture
def sigma_maps(cloud: Cloud) -> Figure:
    """Standard uncertainties of the points in µm, each part that is known in its own map, with its median.

    Raises `DataError` when none is known.
    """
    known = {
        title: 1e3 * sigma for name, title in PARTS.items() if (sigma := getattr(cloud, name)) is not None
    }
    if not known:
        raise DataError("the cloud says nothing of how well its points are known; nothing to draw")
    grid = raster(cloud)
    laid, extent = lay(grid, np.stack(list(known.values()), axis=1))
    width = FULL / len(known) if len(known) > 1 else HALF
    figure = blank(width * len(known), map_height(laid.shape, width) + 0.3)
    sheets = cast(Any, figure.subplots(1, len(known), squeeze=False))[0]
    for axes, (title, sigma), values in zip(sheets, known.items(), np.moveaxis(laid, 2, 0), strict=True):
        mappable = show(axes, values, "cividis", value_range(values, 1, 99), extent)
        colour_bar(figure, axes, mappable, "standard uncertainty in µm")
        axes.set_title(f"{title}\nmedian {np.median(sigma):.3g} µm", fontsize=8.5)
        axes.set(xlabel=grid.names[0], ylabel=grid.names[1])
    return figure


def caption(cloud: Cloud) -> str:
    """What `sigma_maps` shows, and what it means."""
    noise = "Noise: from the fringes, along the camera's ray, independent from point to point."
    if cloud.sigma_mm is None:
        return f"{noise} The calibration says nothing of its own uncertainty."
    return (
        f"{noise} Calibration: from the covariance of its parameters, common to all points, so that it moves "
        "and turns the cloud far more than it bends it. With the best rigid motion taken off, the last map "
        "remains: its part in an error of form. Noise and calibration together: median "
        f"{1e3 * float(np.median(cloud.sigma_mm)):.3g} µm."
    )
