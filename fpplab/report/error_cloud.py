"""A cloud in the colours of its errors, as a PLY file for other programs."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

from fpplab.clouds import Cloud, ply
from fpplab.core.conventions import Map, Mask
from fpplab.core.errors import DataError
from fpplab.core.files import write_large
from fpplab.core.robust import error_limit
from fpplab.report.drawing import ERROR_COLOURS


def write_error_cloud(path: Path, cloud: Cloud, distances_mm: Map, counted: Mask) -> None:
    """Write the points that are compared, with their error in µm, coloured as in the picture of the errors.

    Parameters
    ----------
    path : Path
        PLY file with the properties x, y, z in mm, red, green, blue, and error_um.
    cloud : Cloud
        N points.
    distances_mm : Map
        (N,) signed, NaN where a point has no counterpart.
    counted : Mask
        (N,), the points that are compared.

    Raises
    ------
    DataError
        No point is compared, or the file cannot be written.
    """
    kept = counted & np.isfinite(distances_mm)
    if not kept.any():
        raise DataError(f"{path}: none of the {len(cloud)} points is compared, so there is nothing to write")
    errors = 1e3 * np.asarray(distances_mm, np.float32)[kept]
    limit = error_limit(errors)
    colours = mpl.colormaps[ERROR_COLOURS]((errors / limit + 1) / 2, bytes=True)
    columns = {
        **{name: cloud.points[kept, axis] for axis, name in enumerate("xyz")},
        **{name: colours[:, channel] for channel, name in enumerate(("red", "green", "blue"))},
        "error_um": errors,
    }
    comments = [f"signed distance from the true shape in um, colours from {-limit:.4g} to {limit:.4g} um"]
    write_large(path, lambda stream: ply.write(columns, comments, stream))
