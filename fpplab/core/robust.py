"""Robust least squares (Huber) and its uncertainty where neighbouring points err alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Mask

HUBER = 1.345
"""Residual, in standard deviations, from which Huber's weight usually falls."""
NEGLIGIBLE_RESIDUAL = 1e-12
"""Residual and standard deviation that stand for 0, where something fits exactly."""
FEWEST_CLUSTERS = 3
"""Number of clusters up to which their scatter has no finite variance."""


def robust_spread(residuals: Floats, least: float = NEGLIGIBLE_RESIDUAL) -> float:
    """Estimate the standard deviation of residuals by the median of their sizes.

    Parameters
    ----------
    residuals : ndarray of float64
        Of any shape and unit.
    least : float
        What it is at least, in the same unit.

    Returns
    -------
    float
        In the same unit.
    """
    return max(1.4826 * float(np.median(np.abs(residuals))), least)


def huber_weights(residuals: Floats, spread: float, limit: float = HUBER) -> Floats:
    """Compute Huber's weights.

    Parameters
    ----------
    residuals : ndarray of float64
        Of any shape and unit.
    spread : float
        Their standard deviation in the same unit.
    limit : float
        Residual, in standard deviations, from which the weight falls.

    Returns
    -------
    ndarray of float64
        Of the same shape, 1 up to the limit and falling beyond.
    """
    return np.minimum(1.0, limit * spread / np.maximum(np.abs(residuals), NEGLIGIBLE_RESIDUAL))


def cell_numbers(places: Floats, side: float) -> NDArray[np.int64]:
    """Number the cells that places lie in.

    Parameters
    ----------
    places : ndarray of float64
        (N, D) in mm.
    side : float
        Of a cell, in mm.

    Returns
    -------
    ndarray of int64
        (N,), from 0 on without gaps.
    """
    numbers = np.unique(np.floor(places / side).astype(np.int64), axis=0, return_inverse=True)[1]
    return np.asarray(numbers, np.int64).reshape(-1)


def clustered_covariance(rows: Floats, scores: Floats, within: Mask, cell: NDArray[np.int64]) -> Floats:
    """Compute the covariance of an M-estimate whose residuals are correlated within cells.

    The sandwich estimator for clusters.

    Parameters
    ----------
    rows : ndarray of float64
        (N, n), derivatives of the residuals by the parameters.
    scores : ndarray of float64
        (N,), residuals times their weights.
    within : ndarray of bool
        (N,), True for residuals of full weight.
    cell : ndarray of int64
        (N,), from `cell_numbers`; more cells than parameters.

    Returns
    -------
    ndarray of float64
        (n, n).

    References
    ----------
    Huber and Ronchetti, "Robust statistics", 2009, on the covariance of M-estimates; Liang and Zeger,
    "Longitudinal data analysis using generalized linear models", 1986, on clusters.
    """
    cells, count = int(cell.max()) + 1, rows.shape[1]
    sums = np.zeros((cells, count))
    np.add.at(sums, cell, rows * scores[:, None])
    inverse = np.linalg.pinv(rows[within].T @ rows[within], rcond=1e-12)
    return np.asarray(inverse @ (sums.T @ sums) @ inverse * cells / (cells - count))


def error_limit(errors: NDArray[np.floating[Any]]) -> float:
    """Compute the limit of the symmetric colour range of signed errors.

    Parameters
    ----------
    errors : NDArray of float
        NaN where not known.

    Returns
    -------
    float
        The 98th percentile of the absolute values that are finite; 1 where there are none.
    """
    known = np.abs(errors[np.isfinite(errors)])
    return max(float(np.percentile(known, 98)), 1e-6) if len(known) else 1.0


def multiway_covariance(
    inverse: Floats, scores: Floats, groupings: Sequence[NDArray[np.integer[Any]]]
) -> Floats:
    """Compute the covariance of a least-squares fit whose residuals depend on each other within clusters.

    Of the sandwich form, as a sum over groupings. A residual may depend on others by several of them, and no
    part is subtracted for those that two groupings have in common, so that the sum is not too small. A few
    clusters tell their scatter badly: the error is then distributed as Student's t is, with one degree of
    freedom less than there are clusters, and its variance is given. Groupings of three clusters or fewer say
    nothing and are left out.

    Parameters
    ----------
    inverse : ndarray of float64
        (C, C), inverse of the normal matrix.
    scores : ndarray of float64
        (N, C), derivatives of the residuals by the parameters, times weights and residuals.
    groupings : sequence of ndarray of int
        (N,) each, the number of the cluster of every residual, not negative.

    Returns
    -------
    ndarray of float64
        (C, C).

    References
    ----------
    Cameron, Gelbach and Miller, "Robust inference with multiway clustering", 2011; JCGM 101:2008, 6.4.9.4.
    """
    middle = np.zeros_like(inverse)
    for clusters in groupings:
        present, numbers = np.unique(clusters, return_inverse=True)
        if (count := len(present)) > FEWEST_CLUSTERS:
            sums = np.stack([np.bincount(numbers, column) for column in scores.T])
            # count / (count - 1) for the mean that is fitted, (count - 1) / (count - 3) for Student's t.
            middle += count / (count - 3) * sums @ sums.T
    return np.asarray(inverse @ middle @ inverse)
