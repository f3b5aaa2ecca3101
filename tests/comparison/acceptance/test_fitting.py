"""Fits of spheres and planes: least squares, moving with their points, and what they leave out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.comparison.acceptance import fit_plane, fit_sphere, fit_without_worst
from fpplab.comparison.acceptance.fitting import DISCARDED_SHARE, peak_to_peak
from fpplab.core.conventions import Floats
from fpplab.core.errors import DataError
from fpplab.core.geometry import RigidTransform

SIGMA = 0.010


@st.composite
def poses(draw: st.DrawFn) -> RigidTransform:
    turn = draw(st.tuples(*[st.floats(-3, 3)] * 3))
    shift = draw(st.tuples(*[st.floats(-500, 500)] * 3))
    return RigidTransform.from_vectors(np.array(turn), np.array(shift))


def cap(count: int, sigma: float, seed: int) -> Floats:
    """Points (N, 3) spread evenly over a cap of 60° of a sphere of radius 10 about the origin."""
    random = np.random.default_rng(seed)
    z, turn = random.uniform(0.5, 1.0, count), random.uniform(0, 2 * np.pi, count)
    side = np.sqrt(1 - z**2)
    unit = np.column_stack([side * np.cos(turn), side * np.sin(turn), z])
    return np.asarray((10.0 + sigma * random.standard_normal(count))[:, None] * unit)


@given(poses(), st.integers(0, 1000))
def test_a_sphere_moves_with_its_points(pose: RigidTransform, seed: int) -> None:
    points = cap(200, 0.05, seed)
    here, there = fit_sphere(points), fit_sphere(pose.apply(points))
    assert there.radius == pytest.approx(here.radius, abs=1e-8)
    assert there.centre == pytest.approx(pose.apply(here.centre), abs=1e-8)
    assert there.distances(pose.apply(points)) == pytest.approx(here.distances(points), abs=1e-8)


@given(poses(), st.integers(0, 1000))
def test_a_plane_moves_with_its_points(pose: RigidTransform, seed: int) -> None:
    points = np.random.default_rng(seed).standard_normal((200, 3)) * [40.0, 30.0, 0.02]
    here, there = fit_plane(points), fit_plane(pose.apply(points))
    assert there.point == pytest.approx(pose.apply(here.point), abs=1e-8)
    sign = np.sign((pose.rotation @ here.normal) @ there.normal)
    assert sign * there.distances(pose.apply(points)) == pytest.approx(here.distances(points), abs=1e-8)


@given(st.floats(0.01, 100.0))
def test_a_sphere_scales_with_its_points(scale: float) -> None:
    points = cap(100, 0.05, 7)
    assert fit_sphere(scale * points).radius == pytest.approx(scale * fit_sphere(points).radius, rel=1e-9)


def test_exact_points_give_the_exact_sphere() -> None:
    found = fit_sphere(cap(50, 0.0, 3) + [1.0, 2.0, 400.0])
    assert found.centre == pytest.approx([1.0, 2.0, 400.0], abs=1e-9)
    assert found.radius == pytest.approx(10.0, abs=1e-9)


def test_the_sphere_is_least_squares_in_the_radial_distances() -> None:
    points = cap(300, 0.2, 4)
    found = fit_sphere(points)
    away = points - found.centre
    unit = away / np.linalg.norm(away, axis=1)[:, None]
    gradient = np.column_stack([unit, np.ones(len(unit))]).T @ found.distances(points)
    assert np.abs(gradient).max() < 1e-8


def test_the_radius_of_a_noisy_cap_scatters_without_bias() -> None:
    count, repeats = 400, 100
    radii = np.array([fit_sphere(cap(count, SIGMA, seed)).radius for seed in range(repeats)])
    points = cap(count, 0.0, 0) / 10.0
    design = np.column_stack([points, np.ones(count)])
    predicted = SIGMA * np.sqrt(np.linalg.inv(design.T @ design)[3, 3])
    assert abs(radii.mean() - 10.0) < 4 * predicted / np.sqrt(repeats)
    assert radii.std() == pytest.approx(predicted, rel=4 / np.sqrt(2 * repeats))


def test_a_known_form_error_is_the_span() -> None:
    """A third Legendre polynomial on a whole sphere changes neither its centre nor its radius."""
    count, height = 20_000, 0.02
    z = (np.arange(count) + 0.5) / count * 2 - 1
    turn = np.pi * (1 + np.sqrt(5)) * np.arange(count)
    side = np.sqrt(1 - z**2)
    unit = np.column_stack([side * np.cos(turn), side * np.sin(turn), z])
    points = (10.0 + height * (5 * z**3 - 3 * z) / 2)[:, None] * unit
    sphere, kept = fit_without_worst(points, fit_sphere)
    at = 1.0 - DISCARDED_SHARE  # the poles are what is discarded, 1.8 % of the height
    expected = height * (5 * at**3 - 3 * at)
    # More of one pole than of the other may be, which moves the centre a little.
    assert peak_to_peak(sphere.distances(points)[kept]) == pytest.approx(expected, rel=0.012)
    assert sphere.radius == pytest.approx(10.0, abs=2e-4)


@given(st.integers(50, 3000))
def test_exactly_three_per_mille_are_discarded(count: int) -> None:
    points = cap(count, SIGMA, count)
    sphere, kept = fit_without_worst(points, fit_sphere)
    distances = np.abs(sphere.distances(points))
    assert (~kept).sum() == count * 3 // 1000
    assert kept.all() or distances[~kept].min() >= distances[kept].max()


def test_a_few_gross_errors_change_nothing() -> None:
    points = cap(2000, 0.0, 5)
    points[::500] *= 1.3  # four of 2000, and six may be discarded
    sphere, kept = fit_without_worst(points, fit_sphere)
    assert not kept[::500].any()
    assert sphere.radius == pytest.approx(10.0, abs=1e-9)


@pytest.mark.parametrize(
    "points",
    [np.zeros((3, 3)), np.zeros((9, 3)), np.random.default_rng(0).standard_normal((50, 3)) * [1, 1, 0]],
)
def test_what_is_no_sphere_is_refused(points: Floats) -> None:
    with pytest.raises(DataError, match="sphere"):
        fit_sphere(points)


def test_a_line_is_no_plane() -> None:
    with pytest.raises(DataError, match="line"):
        fit_plane(np.linspace(0, 1, 20)[:, None] * np.array([1.0, 2.0, 3.0]))
