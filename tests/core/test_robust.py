"""Weights of robust least squares."""

from __future__ import annotations

import numpy as np
import pytest

from fpplab.core.robust import HUBER, huber_weights, robust_spread


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
    assert robust_spread(np.zeros(5), least=0.1) == 0.1
