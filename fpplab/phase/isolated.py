"""Single pixels that no neighbour agrees with: a hot pixel of the sensor, or an order wrong by chance."""

from typing import Any

import numpy as np

from fpplab.core.conventions import Map, Mask
from fpplab.phase.chunks import compiled, compiled_part

MIN_NEIGHBOURS = 5
"""Neighbours of one surface without which nothing is said. Chosen: at a straight edge a part has as many."""
MAX_AGREEING = 1
"""Neighbours within half a period that an isolated pixel may have. Chosen: two such pixels may touch, and a
wire one px wide has two."""


def isolated_pixels(coordinate: Map, period_px: float) -> Mask:
    """Pixels half a period or more from all neighbours but one, of which five are nearer to each other."""
    # coordinate (height, width) px; returns the same shape
    isolated = np.zeros(coordinate.shape, np.bool_)
    _mark(coordinate, np.float32(0.5 * period_px), isolated)
    return isolated


@compiled
def _mark(coordinate: Any, limit_px: Any, isolated: Any) -> None:
    height, width = coordinate.shape
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            own = coordinate[v, u]
            # Most pixels agree with those beside them.
            if abs(coordinate[v, u + 1] - own) < limit_px and abs(coordinate[v, u - 1] - own) < limit_px:
                continue
            if own == own and _agreeing(coordinate, v, u, own, limit_px) - 1 <= MAX_AGREEING:
                for k in range(9):
                    other = coordinate[v - 1 + k // 3, u - 1 + k % 3]
                    isolated[v, u] |= _agreeing(coordinate, v, u, other, limit_px) >= MIN_NEIGHBOURS


@compiled_part
def _agreeing(coordinate: Any, v: int, u: int, value: Any, limit_px: Any) -> int:
    """Count the pixels around one, and itself, that are near a value."""
    count = 0
    for k in range(9):
        count += abs(coordinate[v - 1 + k // 3, u - 1 + k % 3] - value) < limit_px
    return count
