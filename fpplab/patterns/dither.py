"""Patterns of few bits: what rounding takes from a mirror is given to the mirrors beside and below it.

The errors then alternate from mirror to mirror, and the blur of the projector's lens takes them off.

Source: Floyd and Steinberg, "An adaptive algorithm for spatial grayscale", 1976.
"""

import numpy as np

from fpplab.core.compiled import kernel
from fpplab.core.conventions import Floats, Lattice

NEXT, BELOW = 7 / 16, (3 / 16, 5 / 16, 1 / 16)
"""Shares of an error for the next mirror and for the three below it, the one behind first (as published)."""
NEXT_DIAMOND, BELOW_DIAMOND = 7 / 16, (4.5 / 16, 4.5 / 16)
"""The same on a diamond lattice, where two mirrors lie below at half a column (chosen: alike)."""


def diffuse(levels: Floats, greys: int, lattice: Lattice, number: int) -> Floats:
    """Round (H, W) levels in [0, 1] to multiples of 1/greys, so that neighbourhoods keep their mean.

    Images of other numbers err independently: with errors alike, or opposite as in images half a period
    apart, means would not lessen them, and nothing in the frames would show how great they are.
    """
    if np.array_equal(levels * greys, np.rint(levels * greys)):
        return levels
    first = np.random.default_rng(number).uniform(-0.5, 0.5, levels.shape[1] + 2)
    continuous = np.ascontiguousarray(levels, np.float64)
    return np.asarray(_diffuse(continuous, greys, first, number % 2, lattice is Lattice.DIAMOND))


@kernel()
def _diffuse(
    levels: Floats, greys: int, first: Floats, backwards: int, diamond: bool
) -> Floats:  # pragma: no cover: compiled
    height, width = levels.shape
    out = np.empty((height, width))
    carried = np.zeros((2, width + 2))  # errors for this row and the next one, a column more on either side
    carried[0] = first
    for row in range(height):
        here, below = carried[row % 2], carried[1 - row % 2]
        below[:] = 0.0
        step = 1 if row % 2 == backwards else -1  # there and back, so that errors have no common direction
        for k in range(width):
            column = k if step > 0 else width - 1 - k
            wanted = levels[row, column] * greys + here[column + 1]
            shown = min(max(np.rint(wanted), 0.0), greys)
            out[row, column] = shown / greys
            error = wanted - shown
            if diamond:
                # Odd rows lie half a column to the right.
                left = column + row % 2
                here[column + 1 + step] += error * NEXT_DIAMOND
                below[left] += error * BELOW_DIAMOND[0]
                below[left + 1] += error * BELOW_DIAMOND[1]
            else:
                here[column + 1 + step] += error * NEXT
                below[column + 1 - step] += error * BELOW[0]
                below[column + 1] += error * BELOW[1]
                below[column + 1 + step] += error * BELOW[2]
    return out
