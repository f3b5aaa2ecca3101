"""Weights of robust least squares."""

import numpy as np
import pytest

from fpplab.core.robust import (
    HUBER,
    MAX_UNBOUNDED_CLUSTERS,
    huber_weights,
    multiway_covariance,
    robust_spread,
)


@pytest.mark.parametrize("spread", [0.01, 1.0, 40.0])
def test_beyond_the_limit_all_residuals_pull_alike(spread: float) -> None:
    """Huber's influence: residual times weight is the residual up to the limit, and the limit beyond."""
    residuals = spread * np.array([[0.0, 0.5, 1.3], [-1.4, 10.0, -1e6]])
    limited = np.clip(residuals, -HUBER * spread, HUBER * spread)
    np.testing.assert_allclose(residuals * huber_weights(residuals, spread), limited, rtol=1e-12)
    limited = np.clip(residuals, -3.0 * spread, 3.0 * spread)
    np.testing.assert_allclose(residuals * huber_weights(residuals, spread, 3.0), limited, rtol=1e-12)


def test_the_spread_is_the_standard_deviation_whatever_a_tenth_of_the_residuals_are() -> None:
    residuals = np.random.default_rng(1).normal(0.0, 0.3, 20_000)
    assert robust_spread(residuals) == pytest.approx(0.3, rel=0.03)
    residuals[:2000] = 1e9
    assert robust_spread(residuals) == pytest.approx(0.3, rel=0.2)
    assert robust_spread(np.zeros(5), min_spread=0.1) == 0.1


@pytest.mark.parametrize("shared", [0.0, 1.0])
def test_the_multiway_covariance_covers_what_rows_and_columns_share(shared: float) -> None:
    """Residuals on a grid, with errors that rows and columns have in common beside their own."""
    rows, columns, repeats = 8, 25, 400
    row, column = (one.ravel() for one in np.mgrid[:rows, :columns])
    random = np.random.default_rng(0)
    x = np.stack([np.ones(row.size), 0.5 * row - 0.2 * column + random.standard_normal(row.size)], axis=1)
    inverse = np.linalg.inv(x.T @ x)
    estimates, stated, alone = [], [], []
    for _ in range(repeats):
        own = random.standard_normal(row.size)
        common = random.standard_normal(rows)[row] + random.standard_normal(columns)[column]
        y = own + shared * common
        found = inverse @ (x.T @ y)
        left = y - x @ found
        estimates.append(found)
        stated.append(np.diag(multiway_covariance(inverse, x * left[:, None], [row, column])))
        alone.append(np.diag(inverse) * left.var())
    true = np.var(estimates, axis=0)
    share = np.mean(stated, axis=0) / true
    assert np.all(share > 0.9)
    assert np.all(share < (1.6 if shared else 3.5))  # independent residuals count in both groupings
    if shared:
        assert np.mean(alone, axis=0)[0] < 0.2 * true[0]
        pulls = np.abs(estimates) / np.sqrt(stated)
        assert np.mean(pulls < 3.0) > 0.97


def test_few_clusters_say_nothing_of_their_scatter() -> None:
    scores = np.random.default_rng(0).standard_normal((60, 2))
    many, few = np.arange(60) % 10, np.arange(60) % MAX_UNBOUNDED_CLUSTERS
    alone = multiway_covariance(np.eye(2), scores, [many])
    np.testing.assert_array_equal(multiway_covariance(np.eye(2), scores, [many, few]), alone)
    sums = scores.reshape(6, 10, 2).sum(axis=0)
    np.testing.assert_allclose(alone, 10 / 7 * sums.T @ sums)
