"""Single pixels that no neighbour agrees with: a hot pixel of the sensor, or an order wrong by chance."""

from __future__ import annotations

from typing import Any

import numpy as np

from fpplab.core.conventions import Map, Mask
from fpplab.phase.chunks import compiled

MIN_NEIGHBOURS = 5
"""Measured neighbours without which nothing is said. Chosen: a surface and its edges have as many."""
MAX_AGREEING = 1
"""Neighbours within half a period that an isolated pixel may have. Chosen: two such pixels may touch, and a
wire one px wide has two."""


def isolated_pixels(coordinate: Map, period_px: float) -> Mask:
    """Pixels that are half a period or more from all measured neighbours but one."""
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
            if (
                not abs(coordinate[v, u + 1] - own) < limit_px
                or not abs(coordinate[v, u - 1] - own) < limit_px
            ):
                measured, agreeing = -1, -1  # without itself
                for r in range(v - 1, v + 2):
                    for c in range(u - 1, u + 2):
                        distance = abs(coordinate[r, c] - own)
                        measured += distance == distance
                        agreeing += distance < limit_px
                isolated[v, u] = measured >= MIN_NEIGHBOURS and agreeing <= MAX_AGREEING
