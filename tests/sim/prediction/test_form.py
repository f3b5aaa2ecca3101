"""What errors of a calibration do to distances, beside measurements that are triangulated with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.reconstruction.points import triangulate
from fpplab.reconstruction.triangulation import coordinate_noise
from sim.prediction.discrepancy import ContrastDeviation, Deviation, Discrepancy
from sim.prediction.figures import MeasuredFigures
from sim.prediction.form import distance_factors
from sim.prediction.intervals import FigureInterval, figure_intervals
from tests.reconstruction.test_triangulation import CALIBRATION, maps_of, plane
from tests.reconstruction.test_uncertainty import an_uncertainty, drawn

BENCHES = 100


def measured(calibration: Calibration, noise_px: float, seed: int) -> Cloud:
    """Points of the plane, as a calibration that may be off gives them."""
    return triangulate(maps_of(plane(), "x", noise_px, seed), calibration, normals=False)


def from_plane(cloud: Cloud) -> float:
    """Mean distance from the plane that fits best, in mm."""
    points = cloud.points.astype(np.float64)
    off = points - points.mean(axis=0)
    return float(np.abs(off @ np.linalg.svd(off, full_matrices=False)[2][2]).mean())


def true_plane() -> trimesh.Trimesh:
    """Two triangles that face the camera, somewhat larger than what it sees."""
    seen = plane()
    corners = seen[[0, 0, -1, -1], [0, -1, -1, 0]]
    wide = corners.mean(axis=0) + 1.2 * (corners - corners.mean(axis=0))
    return trimesh.Trimesh(wide, [[0, 1, 2], [0, 2, 3]], process=False)


@pytest.mark.whole
@pytest.mark.parametrize(("noise_px", "least"), [(0.02, 1.1), (0.002, 4.0)])
def test_intervals_of_distance_hold_benches_with_calibrations_of_known_covariance(
    noise_px: float, least: float
) -> None:
    """Where noise hides most of the calibration's errors, and where these are nearly all there is."""
    uncertain = replace(CALIBRATION, uncertainty=an_uncertainty(3.0))
    noise = coordinate_noise(maps_of(plane(), "x"))
    twin = measured(CALIBRATION, noise_px, 0)
    everywhere = np.ones(plane().shape[:2], bool)
    factors = distance_factors(twin, everywhere, true_plane(), uncertain, noise)
    own = from_plane(twin)
    assert np.median(factors) > least
    benches = enumerate(drawn(uncertain, BENCHES, seed=2), 1)
    found = [from_plane(measured(bench, noise_px, seed)) for seed, bench in benches]
    said = interval_of(own, factors)
    assert 1e3 * np.median(found) == pytest.approx(said.value, rel=0.1)
    assert 0.90 <= np.mean([said.contains(1e3 * one) for one in found]) <= 0.99


def interval_of(distance_mm: float, factors: NDArray[np.float64]) -> FigureInterval:
    one = MeasuredFigures(1e3 * distance_mm, 1.0, 1.0, 0.0)
    return figure_intervals([one, one], factors, Discrepancy(), 0.0, 64)["distance_um"]


def test_an_interval_mixes_calibrations_and_what_bench_and_twin_differed_by() -> None:
    one = MeasuredFigures(10.0, 5.0, 0.9, 1e-6)
    off = Discrepancy(distance=Deviation.of([0.1, -0.1, 0.1, -0.1], fitted=False))
    assert off.distance is not None
    alone = figure_intervals([one, one], np.ones(1), off, 0.0, 64)["distance_um"]
    assert alone.value == 10.0
    assert np.log(alone.high / 10.0) == pytest.approx(1.96 * off.distance.sigma, rel=0.01)
    assert alone.high * alone.low == pytest.approx(100.0)
    # The product of independent log-normal factors is log-normal, and variances add.
    factors = np.exp(0.2 * np.random.default_rng(0).standard_normal(20_000))
    both = figure_intervals([one, one], factors, off, 0.0, 64)["distance_um"]
    assert np.log(both.high / both.low) == pytest.approx(
        2 * 1.96 * np.hypot(0.2, off.distance.sigma), rel=0.03
    )


def test_an_interval_is_of_one_measurement_beside_the_middle_of_the_draws() -> None:
    draws = [MeasuredFigures(x, 5.0, 0.9, 0.0) for x in (9.0, 10.0, 11.0)]
    found = figure_intervals(draws, np.ones(1), Discrepancy(), 0.0, 64)
    relative = 0.1 * np.sqrt(1 + 1 / 3)
    assert np.log(found["distance_um"].high / 10.0) == pytest.approx(1.96 * relative, rel=0.01)
    lucky = [MeasuredFigures(x, 5.0, 0.9, 0.0) for x in (9.0, 9.0, 9.0, 15.0)]
    assert figure_intervals(lucky, np.ones(1), Discrepancy(), 0.0, 64)["distance_um"].value == pytest.approx(
        9.0
    )
    assert found["noise_um"].summary() == pytest.approx({"value": 5.0, "low": 5.0, "high": 5.0})


def test_fringes_finer_than_those_compared_widen_noise_and_distance() -> None:
    one = MeasuredFigures(10.0, 5.0, 0.9, 1e-6)
    compared = ContrastDeviation(stripes=64, relative=0.12 / np.sqrt(4.0**4 - 1.0))
    found = figure_intervals([one, one], np.ones(1), Discrepancy(contrast=compared), 0.0, 256)
    for name, value in (("distance_um", 10.0), ("noise_um", 5.0)):
        assert np.log(found[name].high / value) == pytest.approx(1.96 * 0.12, rel=0.01)


def test_a_calibration_without_covariance_changes_nothing() -> None:
    everywhere = np.ones(plane().shape[:2], bool)
    cloud = measured(CALIBRATION, 0.02, 0)
    factors = distance_factors(cloud, everywhere, true_plane(), CALIBRATION, (1.0, np.inf))
    np.testing.assert_array_equal(factors, [1.0])
