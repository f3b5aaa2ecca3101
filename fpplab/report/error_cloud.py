"""A cloud in the colours of its errors, as a PLY file for other programs."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

from fpplab.clouds import Cloud, ply
from fpplab.core.conventions import Map, Mask
from fpplab.core.drawing import ERROR_COLOURS
from fpplab.core.errors import DataError
from fpplab.core.files import write_large
from fpplab.core.robust import error_limit


def write_error_cloud(path: Path, cloud: Cloud, distances_mm: Map, counted: Mask) -> None:
    """Write the compared points with their errors in µm, coloured as in the picture of the errors."""
    # distances_mm (N,); counted (N,)
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
