"""Repair of fringe orders: neighbours vote on the orders of pixels whose sets disagree."""

import numpy as np
from numpy.typing import NDArray

from fpplab.core.compiled import kernel
from fpplab.core.conventions import Floats, Map
from fpplab.phase.limits import ORDERS


def vote_orders(
    coordinate: Map, pixels: NDArray[np.int64], alternative: Floats, window: int, period: float
) -> NDArray[np.bool_]:
    """Repair fringe orders by local majority, in place."""
    # Light from the surroundings biases a coarse set, and then some orders are wrong by one. The neighbours
    # of a doubtful pixel vote for the one of its two coordinates that lies within a quarter of their
    # difference of their own; a neighbour that is near neither abstains. Only doubtful pixels ever change, so
    # a step edge in clean data cannot be voted away.
    # coordinate (height, width); pixels (P,); alternative (P,); returns (P,)
    other = alternative.astype(np.float32)
    backed = np.zeros(len(pixels), np.bool_)
    for _ in range(ORDERS.max_vote_passes):
        if not _vote_once(coordinate, pixels, other, window // 2, np.float32(period), backed):
            break
    return backed


@kernel(nogil=True)
def _vote_once(
    coordinate: Map,
    pixels: NDArray[np.int64],
    previous: Map,
    reach: int,
    period: np.float32,
    backed: NDArray[np.bool_],
) -> int:
    """One pass; returns how many pixels changed. `previous` keeps what they changed from."""
    height, width = coordinate.shape
    swap = np.zeros(len(pixels), np.bool_)
    for p in range(len(pixels)):
        row, column = pixels[p] // width, pixels[p] % width
        own, runner_up = coordinate[row, column], previous[p]
        near = (abs(own - runner_up) if np.isfinite(runner_up) else period) / 4
        for_own, for_runner_up, measured = 0, 0, 0
        for r in range(max(0, row - reach), min(height, row + reach + 1)):
            for c in range(max(0, column - reach), min(width, column + reach + 1)):
                if r != row or c != column:
                    measured += np.isfinite(coordinate[r, c])
                    for_own += abs(coordinate[r, c] - own) <= near
                    for_runner_up += abs(coordinate[r, c] - runner_up) <= near
        swap[p] = for_runner_up > for_own
        backed[p] = 2 * max(for_own, for_runner_up) > measured
    for p in range(len(pixels)):
        if swap[p]:
            row, column = pixels[p] // width, pixels[p] % width
            coordinate[row, column], previous[p] = previous[p], coordinate[row, column]
    return int(swap.sum())
