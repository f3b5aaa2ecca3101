"""Maps of the points' standard uncertainty: from noise, phase error and calibration, and of the form."""

from typing import Any, cast

import numpy as np
from matplotlib.figure import Figure

from fpplab.clouds import Cloud
from fpplab.clouds.cloud import CloudPoints
from fpplab.core.drawing import FULL, HALF, as_png, colour_bar, draw_map, map_height, new_figure, value_range
from fpplab.core.errors import DataError
from fpplab.patterns.plan import Plan
from fpplab.phase.common_errors import show_common_errors
from fpplab.phase.limits import NOISE
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
    sigmas = {
        title: 1e3 * sigma for name, title in PARTS.items() if (sigma := getattr(cloud, name)) is not None
    }
    if not sigmas:
        raise DataError("the cloud holds no uncertainty of its points; nothing to draw")
    grid = raster_of(cloud)
    mapped, extent = rasterise(grid, np.stack(list(sigmas.values()), axis=1))
    width = FULL / len(sigmas) if len(sigmas) > 1 else HALF
    figure = new_figure(width * len(sigmas), map_height(mapped.shape, width) + 0.3)
    sheets = cast(Any, figure.subplots(1, len(sigmas), squeeze=False))[0]
    for axes, (title, sigma), values in zip(sheets, sigmas.items(), np.moveaxis(mapped, 2, 0), strict=True):
        mappable = draw_map(axes, values, "cividis", value_range(values, 1, 99), extent)
        colour_bar(figure, axes, mappable, "standard uncertainty in µm")
        axes.set_title(f"{title}\nmedian {np.median(sigma):.3g} µm", fontsize=8.5)
        axes.set(xlabel=grid.names[0], ylabel=grid.names[1])
    return figure


def sigma_caption(cloud: Cloud, plan: Plan | None = None) -> str:
    noise = "Noise: predicted from the fringes, along the camera's ray, independent from point to point."
    if cloud.sigma_phase_error_mm is None:
        noise += f" {_why_unknown(plan)}"
    else:
        noise += (
            " Phase error: harmonics of the response, flicker of the lamp and rounding of grey levels; "
            "common to all points of one phase, so that averaging does not reduce it."
        )
    if cloud.sigma_mm is None:
        return f"{noise} The calibration says nothing of its own uncertainty."
    of_form = f"{noise} Calibration: from the covariance of its parameters, common to all points, so that it "
    of_form += "moves and rotates the cloud far more than it deforms it."
    parts = "noise, phase error" if cloud.sigma_phase_error_mm is not None else "noise"
    place = (
        f"Place of the points in the camera's frame: {parts} and calibration, added in squares, median "
        f"{1e3 * float(np.median(cloud.sigma_mm)):.3g} µm; it holds where positions in that frame matter, "
        "such as between scans from several places."
    )
    shape = shape_sigma_mm(cloud)
    if shape is None:
        return f"{of_form} {place}"
    return (
        f"{of_form} The last map is without the best-fitting rigid motion of the whole cloud: the "
        f"calibration's part in errors of form. Shape: {parts} and form, added in squares, median "
        f"{1e3 * float(np.median(shape)):.3g} µm; it is the figure for lengths and form on this part, and "
        f"for a comparison with a true shape after an alignment. {place}"
    )


def shape_sigma_mm(cloud: Cloud) -> CloudPoints | None:
    """Combine what is uncertain in the shape of a cloud, wherever the whole of it lies."""
    # returns (N,) mm
    along = cloud.sigma_along_ray_mm
    return None if along is None or cloud.sigma_form_mm is None else np.hypot(along, cloud.sigma_form_mm)


def _why_unknown(plan: Plan | None) -> str:
    shared = "Phase error, which all points of one phase share, is not known and in no figure here: "
    steps = (
        "the plan has three steps only, and no second fringe set of four stripes or more to compare with; "
        "take four steps or more"
    )
    pixels = (
        f"fewer than {NOISE.min_pixels} of the pixels that are sampled over the image (some 20,000) show "
        "fringes without saturation, as on a part that fills less than about half a percent of the image"
    )
    if plan is None:
        return f"{shared}the file does not hold it, or {pixels}, or {steps}."
    return (
        f"{shared}{pixels if plan.fringe_part and show_common_errors(plan.fringe_part.fringes) else steps}."
    )
