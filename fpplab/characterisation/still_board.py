"""Whether a board stood still while the frames of a pose were taken, by the camera's images alone."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats

WINDOW_PX = (21, 21)
"""Around each point, within which its motion is sought. Chosen: it holds a corner and its neighbourhood."""


def board_shift_px(first: NDArray[np.uint8], last: NDArray[np.uint8], points_px: Floats) -> float | None:
    """Measure how far a board's points moved between two evenly lit images; None where it cannot be seen."""
    # The median over all points: fringes that remain in an image move single points by hundredths of a px.
    start = points_px.astype(np.float32).reshape(-1, 1, 2)
    end, state, _ = cv2.calcOpticalFlowPyrLK(first, last, start, start.copy(), winSize=WINDOW_PX)
    shifts = (end - start)[state.ravel() > 0].reshape(-1, 2)
    return float(np.hypot(*np.median(shifts, axis=0))) if len(shifts) else None
