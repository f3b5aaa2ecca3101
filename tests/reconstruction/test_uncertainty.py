"""Predicted uncertainties against the spread of simulated measurements: noise, calibration, and both."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from fpplab.calibration.displacements import calibration_jacobian
from fpplab.calibration.model import INTRINSICS, PARAMETERS, Calibration, Uncertainty
from fpplab.characterisation import characterise
from fpplab.characterisation.parameters import DEFAULT_SCALE_TOLERANCE, DistortionModel, vectors_of
from fpplab.clouds import Cloud
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.reconstruction.points import triangulate
from fpplab.reconstruction.triangulation import coordinate_noise
from fpplab.reconstruction.uncertainty import (
    RayGrid,
    point_covariance,
    rigid_motions,
    with_uncertainty,
)
from tests.reconstruction.test_triangulation import CALIBRATION as DISTORTED
from tests.reconstruction.test_triangulation import Maps, maps_of, plane, sphere
from tests.support import rigs
from tests.support.warmup import frames_of_plane, small_rig

RIG = small_rig()
ONE_AXIS, TWO_AXES = "plan_paper", "plan_board"
Stack = NDArray[np.float64]
"""Points of repeated measurements, (repeats, N, 3)."""


def test_rigid_motions_are_shifts_and_small_turns() -> None:
    random = np.random.default_rng(1)
    points, shift, turn = random.normal(0, 50, (20, 3)), random.normal(size=3), random.normal(size=3)
    moved = rigid_motions(points) @ np.concatenate([shift, turn])
    np.testing.assert_allclose(moved, shift + np.cross(turn, points), atol=1e-12)


def intrinsics(device: Pinhole) -> NDArray[np.float64]:
    k = device.matrix
    return np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2], *device.distortion])


def vector_of(calibration: Calibration) -> NDArray[np.float64]:
    """In the order of `PARAMETERS`."""
    devices = [intrinsics(d) for d in (calibration.camera, calibration.projector)]
    return np.concatenate([*devices, vectors_of(calibration.T_projector_camera)])


def with_vector(calibration: Calibration, vector: NDArray[np.float64]) -> Calibration:
    camera, projector, pose = np.split(vector, [len(INTRINSICS), 2 * len(INTRINSICS)])
    devices = [
        Pinhole.from_focal(d.size, tuple(x[:2]), tuple(x[2:4]), tuple(x[4:]), d.lattice)
        for d, x in ((calibration.camera, camera), (calibration.projector, projector))
    ]
    return replace(
        calibration,
        camera=devices[0],
        projector=devices[1],
        T_projector_camera=RigidTransform.from_vectors(pose[:3], pose[3:]),
    )


def an_uncertainty(size: float = 1.0) -> Uncertainty:
    """Of every parameter but k3 and beyond, all correlated."""
    sizes = {"f": 0.1, "c": 0.05, "k": 1e-3, "p": 1e-4, "r": 1e-4, "x": 0.03, "y": 0.03, "z": 0.03}
    left = ("k3", "k4", "k5", "k6")
    names = tuple(name for name in PARAMETERS if not name.endswith(left))
    scale = size * np.array([sizes[name.rpartition(".")[2][0]] for name in names])
    mixed = np.random.default_rng(0).normal(size=(len(names), 2 * len(names)))
    correlation = np.corrcoef(mixed)
    return Uncertainty(names, correlation * np.outer(scale, scale))


def drawn(calibration: Calibration, repeats: int, seed: int = 1) -> list[Calibration]:
    """Calibrations at random, whose mean and covariance are exactly those that are stated."""
    assert calibration.uncertainty is not None
    names, covariance = calibration.uncertainty.names, calibration.uncertainty.covariance
    normal = np.random.default_rng(seed).normal(size=(repeats, len(names)))
    whitened = np.linalg.qr(normal - normal.mean(axis=0))[0] * np.sqrt(repeats)
    vectors = np.tile(vector_of(calibration), (repeats, 1))
    vectors[:, [PARAMETERS.index(name) for name in names]] += whitened @ np.linalg.cholesky(covariance).T
    return [with_vector(calibration, vector) for vector in vectors]


def noisy_maps(name: str, seed: int) -> Callable[[], Decoded]:
    """A plane, its paint darker to the right, seen again and again in 8 bits with read-out and shot noise."""
    plan, random = Plan.load(name), np.random.default_rng(seed)
    levels = np.array(frames_of_plane(plan, RIG, 16), np.float32) / 257
    levels *= np.linspace(1.0, 0.3, levels.shape[2], dtype=np.float32)

    def maps() -> Decoded:
        noise = random.standard_normal(levels.shape, np.float32) * np.sqrt(1.5 + 0.04 * levels)
        frames = np.clip(np.rint(levels + noise), 0, 255).astype(np.uint8)
        return decode(Recording(list(frames), plan, RIG.projector.size))

    return maps


def clean_maps(name: str) -> Decoded:
    plan = Plan.load(name)
    return decode(Recording(frames_of_plane(plan, RIG, 16), plan, RIG.projector.size, 16))


def inner(maps: Maps) -> Maps:
    """Without pixels so near the projector's edge that another calibration may put them outside."""
    maps.u[(maps.u < 30) | (maps.u > 880)] = np.nan
    return maps


def repeated(measure: Callable[[int], Cloud], repeats: int) -> Stack:
    """Points of clouds that all have the same pixels."""
    clouds = [measure(seed) for seed in range(repeats)]
    assert all(np.array_equal(c.pixels, clouds[0].pixels) for c in clouds)
    return np.array([c.points for c in clouds], np.float64)


def spread(points: Stack) -> NDArray[np.float64]:
    """Root mean square distance of each point from its mean, (N,)."""
    return np.asarray(np.sqrt(np.sum(np.var(points, axis=0, ddof=1), axis=-1)))


def rms(values: NDArray[np.floating]) -> float:  # type: ignore[type-arg]
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def fitted(points: NDArray[np.float64], onto: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points moved rigidly to be nearest, by least squares, to those of `onto`."""
    turn, _ = Rotation.align_vectors(onto - onto.mean(axis=0), points - points.mean(axis=0))
    return np.asarray(turn.apply(points - points.mean(axis=0)) + onto.mean(axis=0))


@pytest.mark.whole
@pytest.mark.parametrize("name", [ONE_AXIS, TWO_AXES])
def test_noise_of_the_frames_is_the_spread_of_the_points(name: str) -> None:
    maps = noisy_maps(name, seed=3)
    predicted = triangulate(maps(), RIG).sigma_noise_mm
    assert predicted is not None
    found = spread(repeated(lambda _: triangulate(maps(), RIG, normals=False), 100))
    assert rms(found) == pytest.approx(rms(predicted), rel=0.05)
    # One point's spread over 100 scans is itself known to 7 %, and its prediction as well as one scan tells.
    ratio = found / predicted
    assert np.median(ratio) == pytest.approx(1.0, abs=0.03)
    assert np.percentile(ratio, 5) > 0.8
    assert np.percentile(ratio, 95) < 1.2
    assert predicted.max() > 2 * predicted.min()


@pytest.mark.parametrize(("axes", "v_per_u"), [("x", 1.0), ("xy", 1.0), ("xy", 3.0)])
def test_slopes_are_those_of_the_triangulation(axes: str, v_per_u: float) -> None:
    maps = inner(replace(maps_of(plane(), axes), v_per_u=v_per_u))
    cloud = triangulate(maps, DISTORTED, normals=False)
    slopes = calibration_jacobian(cloud.points, DISTORTED, coordinate_noise(maps))
    for index, parameter in enumerate(PARAMETERS):
        largest = np.abs(slopes[..., index]).max()
        if axes == "x" and parameter in ("projector.fy", "projector.cy"):
            assert largest == 0.0
            continue
        step = np.zeros(len(PARAMETERS))
        step[index] = 0.1 / largest
        ahead, behind = (
            triangulate(maps, with_vector(DISTORTED, vector_of(DISTORTED) + sign * step), normals=False)
            for sign in (1, -1)
        )
        assert np.array_equal(ahead.pixels, cloud.pixels)  # type: ignore[arg-type]
        assert np.array_equal(behind.pixels, cloud.pixels)  # type: ignore[arg-type]
        measured = (ahead.points - behind.points.astype(np.float64)) / (2 * step[index])
        # Points of 450 mm are rounded to 3e-5 mm, where the farthest moves by 0.1 mm.
        assert np.abs(measured - slopes[..., index]).max() < 1e-3 * largest, parameter


@settings(max_examples=30, deadline=None)
@given(
    st.tuples(*(st.floats(-100, 100) for _ in "xy"), st.floats(300, 600)),
    st.sampled_from([(1.0, np.inf), (1.0, 1.0), (1.0, 5.0)]),
)
def test_a_longer_baseline_scales_the_cloud(point: tuple[float, ...], noise: tuple[float, float]) -> None:
    """An identity of the model: everything grows with the translation, about the camera."""
    slopes = calibration_jacobian(np.array([point]), RIG, noise)[0]
    grown = slopes[:, -3:] @ RIG.T_projector_camera.translation
    assert np.allclose(grown, point, rtol=1e-9, atol=1e-9)


@pytest.mark.whole
@pytest.mark.parametrize("axes", ["x", "xy"])
def test_calibrations_drawn_from_the_covariance_spread_the_points_as_predicted(axes: str) -> None:
    """On a sphere: of a plane's rigid motions half the terms do not show."""
    rig, maps = replace(DISTORTED, uncertainty=an_uncertainty()), inner(maps_of(sphere(), axes))
    cloud = with_uncertainty(triangulate(maps, rig), rig, coordinate_noise(maps))
    calibrations = drawn(rig, 60)
    points = repeated(lambda k: triangulate(maps, calibrations[k], normals=False), len(calibrations))
    assert np.allclose(spread(points) / cloud.sigma_calibration_mm, 1.0, atol=0.02)
    reference = cloud.points.astype(np.float64)
    left = np.array([fitted(p, reference) - reference for p in points])
    assert np.allclose(np.sqrt(np.mean(np.sum(left**2, -1), 0)) / cloud.sigma_form_mm, 1.0, atol=0.03)
    assert rms(cloud.sigma_form_mm) < 0.5 * rms(cloud.sigma_calibration_mm)  # type: ignore[arg-type]


@pytest.mark.whole
def test_noise_and_calibration_add_in_squares() -> None:
    rig, maps = replace(RIG, uncertainty=an_uncertainty(0.1)), noisy_maps(ONE_AXIS, seed=5)
    calibrations, one = drawn(rig, 100), maps()
    cloud = with_uncertainty(triangulate(one, rig), rig, coordinate_noise(one))
    found = spread(repeated(lambda k: triangulate(maps(), calibrations[k], normals=False), 100))
    assert cloud.sigma_mm is not None
    assert rms(found) == pytest.approx(rms(cloud.sigma_mm), rel=0.05)
    assert np.median(found / cloud.sigma_mm) == pytest.approx(1.0, abs=0.05)
    assert np.percentile(np.abs(found / cloud.sigma_mm - 1.0), 95) < 0.2
    assert 0.5 < rms(cloud.sigma_noise_mm) / rms(cloud.sigma_calibration_mm) < 2  # type: ignore[arg-type]


def test_the_whole_covariance_of_a_point() -> None:
    rig, maps = replace(RIG, uncertainty=an_uncertainty()), clean_maps(ONE_AXIS)
    maps = replace(maps, sigma=np.full_like(maps.sigma, 0.3))
    noise = coordinate_noise(maps)
    cloud = with_uncertainty(triangulate(maps, rig), rig, noise)
    covariance = point_covariance(cloud, rig, noise)
    assert np.allclose(np.trace(covariance, axis1=1, axis2=2), np.square(cloud.sigma_mm), rtol=1e-4)
    assert np.linalg.eigvalsh(covariance).min() > 0
    points = np.array([triangulate(maps, c, normals=False).points for c in drawn(rig, 60)], np.float64)
    offsets = points - points.mean(axis=0)
    moved = np.einsum("rni,rnj->nij", offsets, offsets) / len(points)
    ray = cloud.points / np.linalg.norm(cloud.points, axis=1)[:, None]
    moved += np.einsum("n,ni,nj->nij", np.square(cloud.sigma_noise_mm), ray, ray)
    size = np.trace(covariance, axis1=1, axis2=2)[:, None, None]
    assert np.abs(covariance - moved).max() < 0.02 * size.max()


def test_a_part_cut_out_is_as_uncertain_in_place_but_less_in_form() -> None:
    rig, maps = replace(RIG, uncertainty=an_uncertainty()), clean_maps(ONE_AXIS)
    cloud, noise = triangulate(maps, rig), coordinate_noise(maps)
    near = np.linalg.norm(cloud.points - cloud.points[len(cloud) // 2], axis=1) < 8.0
    whole, part = (
        with_uncertainty(c, rig, noise)
        for c in (cloud, Cloud(cloud.points[near], sigma_noise_mm=cloud.sigma_noise_mm[near]))  # type: ignore[index]
    )
    assert np.array_equal(part.sigma_calibration_mm, whole.sigma_calibration_mm[near])  # type: ignore[index]
    assert rms(part.sigma_form_mm) < 0.3 * rms(whole.sigma_form_mm)  # type: ignore[arg-type]


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_points_are_moved_rigidly_as_far_as_they_can(count: int) -> None:
    rig, maps = replace(RIG, uncertainty=an_uncertainty()), clean_maps(ONE_AXIS)
    points = triangulate(maps, rig).points[:: 96 * 20][:count]
    cloud = with_uncertainty(Cloud(points), rig, coordinate_noise(maps))
    assert (cloud.sigma_calibration_mm > 0.01).all()  # type: ignore[operator]
    assert np.isfinite(cloud.sigma_form_mm).all()
    assert count > 1 or rms(cloud.sigma_form_mm) < 1e-6  # type: ignore[arg-type]


def test_a_calibration_without_covariance_says_nothing() -> None:
    maps = clean_maps(ONE_AXIS)
    cloud = with_uncertainty(triangulate(maps, RIG), RIG, coordinate_noise(maps))
    assert (cloud.sigma_calibration_mm, cloud.sigma_form_mm, cloud.sigma_mm) == (None, None, None)
    assert cloud.sigma_noise_mm is not None
    with pytest.raises(CalibrationError, match="no covariance"):
        point_covariance(cloud, RIG, coordinate_noise(maps))


def test_progress_ends_with_all() -> None:
    rig, maps, told = replace(RIG, uncertainty=an_uncertainty()), clean_maps(ONE_AXIS), list[float]()
    with_uncertainty(triangulate(maps, rig), rig, coordinate_noise(maps), told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0


@pytest.mark.nightly
def test_characterisations_repeated_spread_the_points_as_each_predicts() -> None:
    """From noisy pictures of a board to points: what one characterisation says is what forty do.

    No picture tells the board's scale, so each of the forty has a board of its own: their scales are spread
    as `DEFAULT_SCALE_TOLERANCE` says, exactly, for forty drawn ones would be by a tenth more or less.
    """
    scales = 1.0 + DEFAULT_SCALE_TOLERANCE * norm.ppf((np.arange(40) + 0.5) / 40)
    held, size = rigs.poses(8), rigs.CAMERA.size
    tall = (rigs.SQUARE.size[0], 2250)  # the board lies below the rig's own picture
    u, v = np.meshgrid(np.arange(20.0, size[0], 40), np.arange(20.0, size[1], 40))
    slopes = rigs.CAMERA.normalise(np.stack([u, v], axis=-1))
    points = 250.0 * np.concatenate([slopes, np.ones((*u.shape, 1))], axis=-1)
    seen = rigs.SQUARE.project(points, rigs.PAIR)
    seen[((seen < 30) | (seen > np.array(tall) - 30)).any(axis=-1)] = np.nan
    maps = [np.full(size[::-1], np.nan, np.float32) for _ in range(2)]
    for axis, values in enumerate(maps):
        values[20::40, 20::40] = seen[..., axis]
    decoded = Decoded(*maps, np.zeros_like(maps[0]), np.where(np.isnan(maps[0]), maps[0], 0.0))

    def measured(seed: int) -> Cloud:
        made = scales[seed] * rigs.BOARD.points()
        observations = rigs.observed(held, noise_px=0.05, points=made, seed=seed)
        found = characterise(
            observations, rigs.BOARD, size, tall, level=DistortionModel.TANGENTIAL
        ).calibration
        cloud = triangulate(decoded, found, normals=False)
        return with_uncertainty(cloud, found, coordinate_noise(decoded))

    clouds = [measured(seed) for seed in range(40)]
    assert len(clouds[0]) > 300
    assert all(np.array_equal(c.pixels, clouds[0].pixels) for c in clouds)  # type: ignore[arg-type]
    found = np.array([c.points for c in clouds], np.float64)
    predicted, form = (
        np.sqrt(np.mean([np.square(getattr(c, name)) for c in clouds], axis=0))
        for name in ("sigma_calibration_mm", "sigma_form_mm")
    )
    assert np.median(spread(found) / predicted) == pytest.approx(1.0, abs=0.15)
    left = np.array([fitted(p, found.mean(axis=0)) for p in found])
    assert np.median(spread(left) / form) == pytest.approx(1.0, abs=0.15)


def scattered(rig: Calibration, count: int, seed: int) -> NDArray[np.float32]:
    """Points of the camera's field at 300 to 700 mm, with two on no surface far away."""
    random = np.random.default_rng(seed)
    pixels = random.uniform(0, 1, (count, 2)) * rig.camera.size
    rays = np.concatenate([rig.camera.normalise(pixels), np.ones((count, 1))], axis=-1)
    depths = random.uniform(300.0, 700.0, count)
    depths[:2] = 90.0, 40_000.0
    return np.asarray(rays * depths[:, None], np.float32)


@pytest.mark.parametrize("noise", [(1.0, np.inf), (1.0, 1.3)], ids=["one axis", "two axes"])
def test_a_large_cloud_is_as_uncertain_as_its_points_are(
    noise: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = replace(DISTORTED, uncertainty=an_uncertainty())
    cloud = Cloud(scattered(rig, 60_000, seed=3))
    quick = with_uncertainty(cloud, rig, noise)
    monkeypatch.setattr(RayGrid, "around", lambda points: None)
    exact = with_uncertainty(cloud, rig, noise)
    for name in ("sigma_calibration_mm", "sigma_form_mm"):
        expected = getattr(exact, name)
        assert np.abs(getattr(quick, name) - expected).max() < 0.005 * np.median(expected), name
    assert not np.array_equal(quick.sigma_form_mm, exact.sigma_form_mm)  # type: ignore[arg-type]


def test_the_grid_is_hardly_larger_than_what_it_holds() -> None:
    random = np.random.default_rng(5)
    low, high = np.array([-0.2, 0.1, 400.0]), np.array([0.1, 0.3, 450.0])
    x, y, z = random.uniform(low, high, (50_000, 3)).T
    grid = RayGrid.around(np.stack([x * z, y * z, z], axis=-1))
    assert grid is not None
    for edge, end in ((grid.lower, low), (grid.upper, high)):
        assert np.abs((edge - end) / (high - low)).max() < 0.05


def test_the_grid_reproduces_cubic_functions() -> None:
    """Lagrange's cubic is exact for them, up to the grid's edges, and says nothing beyond.

    What is left is of the lines between the finer nodes.
    """
    points = scattered(DISTORTED, 60_000, seed=4)
    grid = RayGrid.around(points)
    assert grid is not None

    def cubic(at: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y, z = at[:, 0] / at[:, 2], at[:, 1] / at[:, 2], at[:, 2] / 500.0
        return np.stack([1.0 + x**3 * z - 2.0 * y * z**2, 3.0 + x * y**3 * z**3], axis=-1)

    found = np.empty((2, len(points)), np.float32)
    grid.interpolate(cubic(grid.points), points, found)
    inside = np.isfinite(found[0])
    assert not inside[:2].any()
    assert inside.mean() > 0.99
    assert np.allclose(found[:, inside].T, cubic(points[inside].astype(np.float64)), rtol=2e-4)
