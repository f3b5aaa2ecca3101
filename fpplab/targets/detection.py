"""Detection of a whole board in an image, with points located to a small fraction of a pixel."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError
from fpplab.targets.layout import BoardLayout
from fpplab.targets.limits import TARGET_LIMITS as LIMITS
from fpplab.targets.point_fits import fit_centres
from fpplab.targets.views import Detection, stretch_to_8_bits


def detect(layout: BoardLayout, image: NDArray[Any]) -> Detection | None:
    # Of a board that looks the same after half a turn, the order is the one whose x axis points right or down
    # in the image.
    # image (height, width)
    if image.ndim != 2 or min(image.shape) < 16:
        raise CalibrationError(f"a board is detected in a grey image, not in an array {image.shape}")
    level = np.nan_to_num(np.asarray(image, np.float64))
    coarse = layout.find(stretch_to_8_bits(level), level)
    return refine_points(layout, coarse, level) if coarse is not None else None


def refine_points(layout: BoardLayout, coarse: Detection, level: Floats) -> Detection | None:
    # level (height, width)
    centres = fit_centres(level, coarse.pixels, layout.jacobians(coarse), layout.point_model())
    fitted = np.isfinite(centres).all(axis=1)
    if fitted.sum() < LIMITS.min_points:
        return None
    return layout.corrected(Detection(coarse.ids[fitted], centres[fitted]))
