"""Sample points on the lens for few samples of a pixel."""

import numpy as np
import pytest

from sim.light.lens import lens_points
from sim.world.render import subpixel_shifts


@pytest.mark.parametrize("side", [2, 3, 4, 5, 8])
def test_points_have_the_variance_of_the_disc(side: int) -> None:
    points = np.array(lens_points(side**2))
    assert np.linalg.norm(points, axis=1).max() < 1.2
    pairs = len(points) // 2
    covariance = points.T @ points / len(points)
    np.testing.assert_allclose(covariance, np.eye(2) / 4, atol=1e-12)
    np.testing.assert_allclose(points[:pairs], -points[: -pairs - 1 : -1], atol=0)


@pytest.mark.parametrize("side", [3, 4, 5])
def test_opposite_subpixels_have_opposite_lens_points_without_correlation(side: int) -> None:
    places, points = np.array(subpixel_shifts(side)), np.array(lens_points(side**2))
    np.testing.assert_allclose(places, -places[::-1])
    np.testing.assert_allclose(points, -points[::-1])
    common = np.abs(places.T @ points) / len(points)
    assert common.max() < 0.3 * np.sqrt(np.mean(places**2) * np.mean(points**2))


def test_a_single_sample_passes_the_centre_of_the_lens() -> None:
    assert lens_points(1) == ((0.0, 0.0),)
