"""Detection of a whole board in an image, with points located to a small fraction of a pixel.

The kind of board finds its points coarsely. Every point is then refined by fitting a model of its
surroundings: two blurred edges that cross, or the blurred rim of a disc, on a background whose brightness
varies linearly.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError
from fpplab.targets.layout import BoardLayout
from fpplab.targets.profiles import PointModel
from fpplab.targets.views import LEAST_POINTS, Detection, homography, local_frames, stretched, window


def detect(layout: BoardLayout, image: NDArray[Any]) -> Detection | None:
    """Find a board in a grey image.

    Of a board that looks the same after half a turn, the order is the one whose x axis points right or
    down in the image.

    Parameters
    ----------
    layout : BoardLayout
        The board.
    image : NDArray[Any]
        Grey image (height, width) of integers or floats.

    Returns
    -------
    Detection or None
        Points found; None when the board is not there.

    Raises
    ------
    CalibrationError
        The image is not two-dimensional or smaller than 16 px.
    """
    if image.ndim != 2 or min(image.shape) < 16:
        raise CalibrationError(f"a board is detected in a grey image, not in an array {image.shape}")
    level = np.nan_to_num(np.asarray(image, np.float64))
    coarse = layout.find(stretched(level), level)
    return refined(layout, coarse, level) if coarse is not None else None


def refined(layout: BoardLayout, coarse: Detection, level: Floats) -> Detection | None:
    """Locate every point by a model fit of its own.

    Parameters
    ----------
    layout : BoardLayout
        The board.
    coarse : Detection
        Points to about a pixel.
    level : Floats
        Grey image (height, width).

    Returns
    -------
    Detection or None
        Without the points whose fit failed; None when fewer than `LEAST_POINTS` are left.
    """
    board = layout.points()[coarse.ids, :2]
    frames = local_frames(homography(layout, coarse), board)
    model = layout.point_model()
    kept = []
    for index, (pixel, frame) in enumerate(zip(coarse.pixels, frames, strict=True)):
        centre = _fit_centre(level, pixel, frame, model)
        if centre is not None:
            kept.append((index, centre))
    if len(kept) < LEAST_POINTS:
        return None
    return layout.corrected(Detection(coarse.ids[[i for i, _ in kept]], np.array([c for _, c in kept])))


def _fit_centre(level: Floats, pixel: Floats, frame: Floats, model: PointModel) -> Floats | None:
    """Centre in px of the model that fits best around `pixel`; None when there is none."""
    x, y, seen = window(level, pixel, frame, model.half_mm)
    if len(seen) < 25:
        return None

    def misfit(theta: Floats) -> Floats:
        # The background's plane and the model's gain are linear parameters: they are solved for within.
        basis = np.stack([np.ones_like(x), x, y, model.shape(theta, x, y)], axis=1)
        normal = basis.T @ basis + 1e-9 * len(x) * np.eye(4)
        return np.asarray(seen - basis @ np.linalg.solve(normal, basis.T @ seen))

    fit = least_squares(misfit, model.start(frame), method="lm", max_nfev=400)
    shift = np.linalg.solve(frame, fit.x[:2])
    if not fit.success or not np.all(np.isfinite(fit.x)) or np.abs(shift).max() > 0.5 * model.half_mm:
        return None
    return np.asarray(pixel + fit.x[:2])
