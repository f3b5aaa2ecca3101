"""Robust least squares (Huber) and its uncertainty where errors of neighbouring points correlate."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Map, Mask
from fpplab.core.errors import DataError

HUBER = 1.345
"""Residual, in standard deviations, from which Huber's weight usually falls. Derived: the estimate is
then 95 % as efficient as a mean where errors are normal."""
NEGLIGIBLE_RESIDUAL = 1e-12
"""Residual and standard deviation that stand for 0, where something fits exactly (chosen)."""
MAX_UNBOUNDED_CLUSTERS = 3
"""Number of clusters up to which their scatter has no finite variance. Derived: Student's t distribution has
none with two degrees of freedom or fewer."""


def robust_spread(residuals: Floats, min_spread: float = NEGLIGIBLE_RESIDUAL) -> float:
    return max(1.4826 * float(np.median(np.abs(residuals))), min_spread)


def huber_weights(residuals: Floats, spread: float, limit: float = HUBER) -> Floats:
    return np.minimum(1.0, limit * spread / np.maximum(np.abs(residuals), NEGLIGIBLE_RESIDUAL))


def cell_numbers(places: Floats, side: float) -> NDArray[np.int64]:
    # places (N, D) mm; returns (N,)
    numbers = np.unique(np.floor(places / side).astype(np.int64), axis=0, return_inverse=True)[1]
    return np.asarray(numbers, np.int64).reshape(-1)


def clustered_covariance(rows: Floats, scores: Floats, is_inlier: Mask, cell: NDArray[np.int64]) -> Floats:
    """Compute the covariance of an M-estimate whose residuals are correlated within cells."""
    # The sandwich estimator for clusters.
    # rows (N, n); scores (N,); is_inlier (N,); cell (N,); returns (n, n)
    cells, count = int(cell.max()) + 1, rows.shape[1]
    sums = np.zeros((cells, count))
    np.add.at(sums, cell, rows * scores[:, None])
    inverse = np.linalg.pinv(rows[is_inlier].T @ rows[is_inlier], rcond=1e-12)
    return np.asarray(inverse @ (sums.T @ sums) @ inverse * cells / (cells - count))


def error_limit(errors: NDArray[np.floating[Any]]) -> float:
    sizes = np.abs(errors[np.isfinite(errors)])
    return max(float(np.percentile(sizes, 98)), 1e-6) if len(sizes) else 1.0


def multiway_covariance(
    inverse: Floats, scores: Floats, groupings: Sequence[NDArray[np.integer[Any]]]
) -> Floats:
    """Compute the covariance of a least-squares fit whose residuals depend on each other within clusters."""
    # Of the sandwich form, as a sum over groupings. A residual may depend on others by several of them, and
    # no part is subtracted for those that two groupings have in common, so that the sum is not too small. A
    # few clusters estimate their scatter poorly: the error then follows Student's t distribution with one
    # degree of freedom less than there are clusters, and its variance is given. Groupings of three clusters
    # or fewer say nothing and are left out.
    # inverse (C, C); scores (N, C); groupings (N,); returns (C, C)
    middle = np.zeros_like(inverse)
    for clusters in groupings:
        present, numbers = np.unique(clusters, return_inverse=True)
        if (count := len(present)) > MAX_UNBOUNDED_CLUSTERS:
            sums = np.stack([np.bincount(numbers, column) for column in scores.T])
            # count / (count - 1) for the mean that is fitted, (count - 1) / (count - 3) for Student's t.
            middle += count / (count - 3) * sums @ sums.T
    return np.asarray(inverse @ middle @ inverse)


def value_range(values: Map, lower_percentile: float, upper_percentile: float) -> tuple[float, float]:
    finite = values[np.isfinite(values)]
    if not len(finite):
        raise DataError("the map has no measured pixel; nothing to draw")
    low, high = np.percentile(finite, (lower_percentile, upper_percentile))
    return float(low), float(max(high, low + 1e-6))
