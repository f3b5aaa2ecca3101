"""Regions of the camera's image, over which the measures of the set-up are given."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Mask

REGIONS = (4, 6)  # (rows, columns) of regions into which the image is divided (chosen)


def region_slices(shape: tuple[int, ...]) -> Iterator[tuple[tuple[int, int], tuple[slice, slice]]]:
    # shape (height, width); returns (tuple of int, tuple of slice)
    rows, columns = (
        np.linspace(0, size, n + 1).astype(int) for size, n in zip(shape[:2], REGIONS, strict=True)
    )
    for row in range(REGIONS[0]):
        for column in range(REGIONS[1]):
            yield (
                (row, column),
                (slice(rows[row], rows[row + 1]), slice(columns[column], columns[column + 1])),
            )


def region_medians(values: NDArray[np.floating[Any]], valid: Mask) -> Floats:
    """Compute the median in each region of which at least a tenth is known."""
    # values (height, width); known (height, width)
    medians = np.full(REGIONS, np.nan)
    for region, part in region_slices(values.shape):
        inside = values[part][valid[part]]
        if inside.size and inside.size >= 0.1 * values[part].size:
            medians[region] = np.median(inside)
    return medians
