"""What errors of a calibration do to distances, beside measurements that are triangulated with them."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison.alignment import AlignmentMesh, refine_pose
from fpplab.core.geometry import RigidTransform
from fpplab.reconstruction.points import triangulate
from fpplab.reconstruction.triangulation import coordinate_noise
from sim.prediction.discrepancy import USUAL_DISTANCE, ContrastDeviation, Deviation, Discrepancy
from sim.prediction.figures import MeasuredFigures, SeenShape
from sim.prediction.form import CalibrationEffects, calibration_effects
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
    effects = calibration_effects(twin, seen_plane(), uncertain, noise)
    factors = effects.distance
    own = from_plane(twin)
    assert np.median(factors) > least
    benches = enumerate(drawn(uncertain, BENCHES, seed=2), 1)
    clouds = [measured(bench, noise_px, seed) for seed, bench in benches]
    found = [from_plane(cloud) for cloud in clouds]
    moved_um = [removed_by_alignment_um(cloud) for cloud in clouds[::4]]
    low, high = np.quantile(effects.place_um, (0.025, 0.975))
    assert 0.84 <= np.mean([low <= one <= high for one in moved_um]) <= 1.0
    assert np.median(moved_um) == pytest.approx(np.median(effects.place_um), rel=0.35)
    said = interval_of(own, factors)
    assert 1e3 * np.median(found) == pytest.approx(said.value, rel=0.1)
    assert 0.90 <= np.mean([said.contains(1e3 * one) for one in found]) <= 0.99


def seen_plane() -> SeenShape:
    everywhere = np.ones(plane().shape[:2], bool)
    return SeenShape(true_plane(), everywhere, everywhere, np.zeros((0, 3)), everywhere[:, 0])


def removed_by_alignment_um(cloud: Cloud) -> float:
    points = cloud.points[::20].astype(np.float64)
    pose = refine_pose(points, AlignmentMesh(true_plane()), RigidTransform.identity(), 20)[0]
    return 1e3 * float(np.sqrt(np.mean(np.sum((points - pose.apply(points)) ** 2, axis=1))))


def of_distance(factors: NDArray[np.float64]) -> CalibrationEffects:
    return CalibrationEffects(factors, np.zeros(1))


def interval_of(distance_mm: float, factors: NDArray[np.float64]) -> FigureInterval:
    one = MeasuredFigures(1e3 * distance_mm, 1.0, 1.0, 0.0)
    return figure_intervals([one, one], of_distance(factors), Discrepancy(), np.ones(1), 64)["distance_um"]


def test_an_interval_mixes_calibrations_and_what_bench_and_twin_differed_by() -> None:
    one = MeasuredFigures(10.0, 5.0, 0.9, 1e-6)
    off = Discrepancy(distance=Deviation.of([0.1, -0.1, 0.1, -0.1], fitted=False))
    assert off.distance is not None
    alone = figure_intervals([one, one], of_distance(np.ones(1)), off, np.ones(1), 64)["distance_um"]
    assert alone.value == 10.0
    assert np.log(alone.high / 10.0) == pytest.approx(1.96 * off.distance.sigma(USUAL_DISTANCE), rel=0.01)
    assert alone.high * alone.low == pytest.approx(100.0)
    # The product of independent log-normal factors is log-normal, and variances add.
    factors = np.exp(0.2 * np.random.default_rng(0).standard_normal(20_000))
    both = figure_intervals([one, one], of_distance(factors), off, np.ones(1), 64)["distance_um"]
    assert np.log(both.high / both.low) == pytest.approx(
        2 * 1.96 * np.hypot(0.2, off.distance.sigma(USUAL_DISTANCE)), rel=0.03
    )


def test_an_interval_is_of_one_measurement_beside_the_middle_of_the_draws() -> None:
    draws = [MeasuredFigures(x, 5.0, 0.9, 0.0) for x in (9.0, 10.0, 11.0)]
    found = figure_intervals(draws, of_distance(np.ones(1)), Discrepancy(), np.ones(1), 64)
    relative = 0.1 * np.sqrt(1 + 1 / 3)
    assert np.log(found["distance_um"].high / 10.0) == pytest.approx(1.96 * relative, rel=0.01)
    lucky = [MeasuredFigures(x, 5.0, 0.9, 0.0) for x in (9.0, 9.0, 9.0, 15.0)]
    assert figure_intervals(lucky, of_distance(np.ones(1)), Discrepancy(), np.ones(1), 64)[
        "distance_um"
    ].value == pytest.approx(9.0)
    assert found["noise_um"].summary() == pytest.approx({"value": 5.0, "low": 5.0, "high": 5.0})


def test_fringes_finer_than_those_compared_widen_noise_and_distance() -> None:
    one = MeasuredFigures(10.0, 5.0, 0.9, 1e-6)
    compared = ContrastDeviation(stripes=64, relative=0.12 / np.sqrt(4.0**4 - 1.0))
    found = figure_intervals(
        [one, one], of_distance(np.ones(1)), Discrepancy(contrast=compared), np.ones(1), 256
    )
    for name, value in (("distance_um", 10.0), ("noise_um", 5.0)):
        assert np.log(found[name].high / value) == pytest.approx(1.96 * 0.12, rel=0.01)


def test_few_comparisons_count_beside_those_of_other_twins() -> None:
    """One scan neither makes intervals three times its deviation, nor none by chance agreement."""
    chance, usual, far = (Deviation.of([value], False).sigma(0.07) for value in (0.0, 0.07, 0.7))
    assert 0.07 < chance < usual < 0.1
    assert 1.96 * far > 0.7
    assert Deviation.of([0.02, -0.02] * 50, False).sigma(0.07) == pytest.approx(0.02, rel=0.3)


def test_an_unknown_surface_may_have_any_reflectance() -> None:
    one, any_reflectance = MeasuredFigures(10.0, 5.0, 0.9, 1e-6), 0.88 / ((np.arange(1_000) + 0.5) / 1_000)
    found = figure_intervals([one, one], of_distance(np.ones(1)), Discrepancy(), any_reflectance, 64)
    for name, value in (("distance_um", 10.0), ("noise_um", 5.0)):
        assert found[name].value == value
        assert 0.85 * value < found[name].low < value
        assert found[name].contains(value * 0.88 / 0.05)


def test_a_calibration_without_covariance_changes_nothing() -> None:
    cloud = measured(CALIBRATION, 0.02, 0)
    moved = RigidTransform.from_vectors(np.zeros(3), np.array([0.0, 0.3, 0.4]))
    effects = calibration_effects(cloud, seen_plane(), CALIBRATION, (1.0, np.inf), moved)
    np.testing.assert_array_equal(effects.distance, [1.0])
    np.testing.assert_allclose(effects.place_um, [500.0], rtol=1e-3)
