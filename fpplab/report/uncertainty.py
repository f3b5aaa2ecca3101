"""Maps of the points' standard uncertainty: from noise, phase error and calibration, and of the form."""

import numpy as np

from fpplab.clouds import Cloud
from fpplab.clouds.cloud import CloudPoints
from fpplab.core.errors import DataError
from fpplab.core.robust import value_range
from fpplab.patterns.plan import Plan
from fpplab.phase.common_errors import show_common_errors
from fpplab.phase.limits import NOISE
from fpplab.report.map_sheet import MapSheet, draw_maps, drawn_pixels
from fpplab.report.raster import raster_of, rasterise

PARTS = {
    "sigma_noise_mm": "noise",
    "sigma_phase_error_mm": "phase error",
    "sigma_calibration_mm": "calibration",
    "sigma_form_mm": "calibration, without rigid motion",
}
"""The uncertainties that a cloud may hold, and their titles."""


def sigma_maps(cloud: Cloud) -> bytes:
    sigmas = {
        title: 1e3 * sigma for name, title in PARTS.items() if (sigma := getattr(cloud, name)) is not None
    }
    if not sigmas:
        raise DataError("the cloud holds no uncertainty of its points; nothing to draw")
    grid = raster_of(cloud)
    mapped, extent = rasterise(grid, np.stack(list(sigmas.values()), axis=1))
    sheets = [
        MapSheet(
            values,
            "cividis",
            value_range(drawn_pixels(values), 1, 99),
            "standard uncertainty in µm",
            extent,
            grid.names,
            (title, f"median {np.median(sigma):.3g} µm"),
        )
        for (title, sigma), values in zip(sigmas.items(), np.moveaxis(mapped, 2, 0), strict=True)
    ]
    return draw_maps(*sheets)


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
