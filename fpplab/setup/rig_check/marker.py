"""The marker: uniform grey-level images, the only images that a check shows besides a plan's."""

import numpy as np
from numpy.typing import NDArray

MARKER_ORDER = (7, 0, 5, 9, 4, 8, 3, 10, 1, 6, 2, 11)
"""Levels by their rank, 0 the darkest. Twelve fill the places of four 24-bit images. Of orders whose
neighbours differ by four steps or more this one, of many tried, leaves the greatest departure between any two
slips: 6 % of the range, 2 % at a gamma of 2.2. Both its ends are brighter than the darkness around it.
"""


def marker() -> NDArray[np.int64]:
    # returns (12,)
    return np.asarray(np.rint(np.array(MARKER_ORDER) * 255 / (len(MARKER_ORDER) - 1)), np.int64)


def middle_level() -> int:
    return int(np.sort(marker())[len(MARKER_ORDER) // 2])
