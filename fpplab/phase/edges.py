"""What blur costs where brightness changes: coordinates are drawn to the brighter side."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Map
from fpplab.phase.chunks import compiled

_ROWS = 256  # rows that one thread takes at a time (chosen)
_f = np.float32
_ZERO, _ONE = _f(0), _f(1)


def add_errors_at_edges(
    coordinate: Map, brightness: NDArray[np.uint8], phase_error: Map, blur_px2: float
) -> None:
    """Add `w² ∇u·∇ln A` to the uncertainty of a coordinate u, in place; A is the brightness, w the blur."""
    # coordinate (height, width) px; brightness (height, width); phase_error (height, width) px
    strength = _f(0.25 * blur_px2)
    height = len(coordinate)
    with ThreadPoolExecutor() as pool:
        list(
            pool.map(
                lambda first: _add_errors(
                    coordinate, brightness, phase_error, strength, first, min(first + _ROWS, height - 1)
                ),
                range(1, height - 1, _ROWS),
            )
        )


@compiled
def _add_errors(
    coordinate: Any, brightness: Any, phase_error: Any, strength: Any, first: int, end: int
) -> None:
    for v in range(first, end):
        for u in range(1, coordinate.shape[1] - 1):
            across, along = coordinate[v, u + 1] - coordinate[v, u - 1], _f(brightness[v, u + 1])
            across *= along - _f(brightness[v, u - 1])
            down, along = coordinate[v + 1, u] - coordinate[v - 1, u], _f(brightness[v + 1, u])
            down *= along - _f(brightness[v - 1, u])
            # A neighbour that is not measured tells nothing.
            across, down = across if across == across else _ZERO, down if down == down else _ZERO
            error = strength * (across + down) / max(_f(brightness[v, u]), _ONE)
            phase_error[v, u] = np.sqrt(phase_error[v, u] * phase_error[v, u] + error * error)
