"""Maps of the points' standard uncertainty: from noise, phase error and calibration, and of the form."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from matplotlib.figure import Figure

from fpplab.clouds import Cloud
from fpplab.core.errors import DataError
from fpplab.report.drawing import (
    FULL,
    HALF,
    as_png,
    colour_bar,
    draw_map,
    map_height,
    new_figure,
    value_range,
)
from fpplab.report.raster import raster_of, rasterise

PARTS = {
    "sigma_noise_mm": "noise",
    "sigma_phase_error_mm": "phase error",
    "sigma_calibration_mm": "calibration",
    "sigma_form_mm": "calibration, without rigid motion",
}
"""The uncertainties that a cloud may hold, and their titles."""


@as_png
def sigma_maps(cloud: Cloud) -> Figure:
    """Draw the standard uncertainties of the points in µm, a map with its median for each part that is known.

    Parameters
    ----------
    cloud : Cloud
        With at least one uncertainty.

    Returns
    -------
    bytes
        PNG file.

    Raises
    ------
    DataError
        The cloud holds no uncertainty, or no points.
    """
    known = {
        title: 1e3 * sigma for name, title in PARTS.items() if (sigma := getattr(cloud, name)) is not None
    }
    if not known:
        raise DataError("the cloud holds no uncertainty of its points; nothing to draw")
    grid = raster_of(cloud)
    mapped, extent = rasterise(grid, np.stack(list(known.values()), axis=1))
    width = FULL / len(known) if len(known) > 1 else HALF
    figure = new_figure(width * len(known), map_height(mapped.shape, width) + 0.3)
    sheets = cast(Any, figure.subplots(1, len(known), squeeze=False))[0]
    for axes, (title, sigma), values in zip(sheets, known.items(), np.moveaxis(mapped, 2, 0), strict=True):
        mappable = draw_map(axes, values, "cividis", value_range(values, 1, 99), extent)
        colour_bar(figure, axes, mappable, "standard uncertainty in µm")
        axes.set_title(f"{title}\nmedian {np.median(sigma):.3g} µm", fontsize=8.5)
        axes.set(xlabel=grid.names[0], ylabel=grid.names[1])
    return figure


def sigma_caption(cloud: Cloud) -> str:
    """Explain what `sigma_maps` shows.

    Parameters
    ----------
    cloud : Cloud
        With at least the uncertainty from noise.

    Returns
    -------
    str
        Sentences for the figure's caption.
    """
    noise = "Noise: predicted from the fringes, along the camera's ray, independent from point to point."
    if cloud.sigma_phase_error_mm is None:
        noise += (
            " Errors of the phase that all points of one phase share cannot be told from these frames: "
            "measure the response, or take four steps or more."
        )
    else:
        noise += (
            " Phase error: harmonics of the response, flicker of the lamp and rounding of grey levels; "
            "common to all points of one phase, so that averaging does not lessen it."
        )
    if cloud.sigma_mm is None:
        return f"{noise} The calibration says nothing of its own uncertainty."
    return (
        f"{noise} Calibration: from the covariance of its parameters, common to all points, so that it moves "
        "and rotates the cloud far more than it deforms it. The last map is without the best-fitting rigid "
        "motion: the calibration's part in errors of form. All together: median "
        f"{1e3 * float(np.median(cloud.sigma_mm)):.3g} µm."
    )
