"""Triangulation against analytic surfaces seen through two strongly distorted devices."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import local_quadric_distance
from fpplab.core.errors import CalibrationError, DataError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.reconstruction import triangulation
from fpplab.reconstruction.points import triangulate
from fpplab.reconstruction.triangulation import camera_rays, camera_slopes

W, H = 160, 120
CAMERA = Pinhole.from_focal((W, H), (420.0, 424.0), (77.0, 61.0), (-0.25, 0.1, 0.002, -0.001, 0.03))
PROJECTOR = Pinhole.from_focal(
    (912, 1140), (1700.0, 1690.0), (450.0, 600.0), (-0.2, 0.1, -0.002, 0.001, 0.05)
)
PLACE = np.array([-150.0, 6.0, 4.0])
TURN = RigidTransform.from_vectors(np.array([0.02, -np.arctan2(150.0, 450.0), 0.01]), np.zeros(3))
CALIBRATION = Calibration(CAMERA, PROJECTOR, RigidTransform(TURN.rotation, -TURN.rotation @ PLACE), {})
RATIONAL = (0.5, 0.1, 4e-3, -3e-3, 0.01, 0.9, 0.3, 0.02)
MICRON = 1e-3


@dataclass(frozen=True, eq=False)
class Maps:
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    sigma: NDArray[np.float32]
    v_per_u: float = 1.0
    sigma_phase_error: NDArray[np.float32] | None = None


def test_the_phase_error_is_propagated_as_noise_is() -> None:
    maps = maps_of(plane(), "x", noise_px=0.05)
    cloud = triangulate(maps, CALIBRATION)
    assert cloud.sigma_phase_error_mm is None
    error = np.linspace(0.01, 0.3, maps.u.size, dtype=np.float32).reshape(maps.u.shape)
    noise = triangulate(replace(maps, sigma=error), CALIBRATION).sigma_noise_mm
    found = triangulate(replace(maps, sigma_phase_error=error), CALIBRATION)
    assert found.sigma_phase_error_mm is not None
    np.testing.assert_allclose(found.sigma_phase_error_mm, noise, rtol=1e-5)
    np.testing.assert_array_equal(found.sigma_noise_mm, cloud.sigma_noise_mm)


def plane() -> NDArray[np.float64]:
    """(H, W, 3) on the plane n·X = d along the camera's rays."""
    return on_rays(lambda a, b: 450.0 / (0.3 * a - 0.2 * b + 1.0))


def sphere() -> NDArray[np.float64]:
    def depth(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        square, centre = a**2 + b**2 + 1.0, 600.0
        return np.asarray((centre - np.sqrt(centre**2 - square * (centre**2 - 160.0**2))) / square)

    return on_rays(depth)


def step() -> NDArray[np.float64]:
    return on_rays(lambda a, b: np.where(a < 0.02, 450.0, 430.0))


def on_rays(depth: object) -> NDArray[np.float64]:
    a, b = camera_slopes(CAMERA)
    z = depth(a, b)  # type: ignore[operator]
    return np.stack([a * z, b * z, z], axis=-1)


def maps_of(points: NDArray[np.float64], axes: str = "xy", noise_px: float = 0.0, seed: int = 0) -> Maps:
    seen = PROJECTOR.project(points, CALIBRATION.T_projector_camera)
    inside = ((seen >= -0.5) & (seen <= np.array(PROJECTOR.size) - 0.5)).all(axis=-1)
    assert inside.mean() > 0.5
    seen += np.random.default_rng(seed).normal(0.0, noise_px, seen.shape)
    seen[~inside] = np.nan
    nothing = np.full(inside.shape, np.nan, np.float32)
    u, v = (seen[..., k].astype(np.float32) if axis in axes else nothing for k, axis in enumerate("xy"))
    return Maps(u, v, np.where(inside, np.float32(noise_px), np.float32(np.nan)))


@pytest.mark.parametrize("axes", ["xy", "x"])
@pytest.mark.parametrize("surface", [plane, sphere, step])
def test_points_lie_on_the_true_surface_to_a_micron(surface: object, axes: str) -> None:
    truth = surface()  # type: ignore[operator]
    maps = maps_of(truth, axes)
    cloud = triangulate(maps, CALIBRATION)
    assert len(cloud) == np.isfinite(maps.u).sum()
    u, v = cloud.pixels.T  # type: ignore[union-attr]
    assert np.abs(cloud.points - truth[v, u]).max() < MICRON
    assert cloud.points.dtype == np.float32
    assert cloud.size == (W, H)


def test_rational_lenses_give_the_true_surface_to_a_micron() -> None:
    """Both wide: half the camera's rays and the projector's are bent by more than a tenth."""
    camera = Pinhole.from_focal((W, H), (110.0, 111.0), (77.0, 61.0), RATIONAL)
    projector = Pinhole.from_focal((912, 1140), (700.0, 690.0), (450.0, 600.0), RATIONAL)
    calibration = replace(CALIBRATION, camera=camera, projector=projector)
    a, b = camera_slopes(camera)
    z = 450.0 / (0.3 * a - 0.2 * b + 1.0)
    truth = np.stack([a * z, b * z, z], axis=-1)
    seen = projector.project(truth, calibration.T_projector_camera)
    seen[((seen < -0.5) | (seen > np.array(projector.size) - 0.5)).any(axis=-1)] = np.nan
    assert np.isfinite(seen[..., 0]).mean() > 0.5
    # Coordinates are single precision: of 1000 px half a last digit is 3e-5 px, here 10 µm in 450 mm.
    exact = seen.astype(np.float32)
    cloud = triangulate(Maps(exact[..., 0], exact[..., 1], np.full((H, W), 0.1, np.float32)), calibration)
    assert len(cloud) == np.isfinite(exact[..., 0]).sum()
    u, v = cloud.pixels.T  # type: ignore[union-attr]
    assert np.abs(cloud.points - truth[v, u]).max() < 30 * MICRON
    assert cloud.epipolar_px.max() < 1e-4  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("lens", "focal"),
    [
        ((-0.25, 0.1, 0.002, -0.001, 0.03), 110.0),
        (RATIONAL, 110.0),
        ((-3.0, 0.0, 0.0, 0.0, 0.0), 110.0),
        ((-0.03, 0.5, 0.0, 0.0, -0.22, -0.43, -0.43, 0.37), 40.0),  # pixels far beyond the reach of slopes
    ],
)
def test_camera_rays_are_those_of_the_model(lens: tuple[float, ...], focal: float) -> None:
    camera = Pinhole.from_focal((W, H), (focal, focal + 1.0), (77.0, 61.0), lens)
    v, u = np.mgrid[0:H, 0:W].astype(np.float64)
    pixels = np.stack([u, v], axis=-1)
    rays = camera_rays(camera)
    np.testing.assert_allclose(rays[..., :2], camera.normalise(pixels), rtol=0, atol=1e-9)
    assert (rays[..., 2] == 1).all()
    assert np.nanmax(np.abs(camera.project(rays) - pixels)) < 1e-9


def test_pixels_where_the_camera_model_folds_have_no_ray() -> None:
    folding = replace(CAMERA, distortion=np.array([-3.0, 0.0, 0.0, 0.0, 0.0]))
    a, _ = camera_slopes(folding)
    assert np.isnan(a[0, 0])
    assert np.isfinite(a[61, 77])


def test_rays_are_kept_per_camera() -> None:
    first = camera_slopes(CAMERA)
    assert camera_slopes(replace(CAMERA)) is first
    assert camera_slopes(replace(CAMERA, distortion=np.zeros(5))) is not first
    triangulation.forget_cameras()
    assert camera_slopes(CAMERA) is not first


@pytest.mark.parametrize("axes", ["xy", "x"])
def test_sigma_is_the_scatter_along_the_ray(axes: str) -> None:
    truth = plane()
    errors, sigmas = [], []
    for seed in range(8):
        cloud = triangulate(maps_of(truth, axes, noise_px=0.05, seed=seed), CALIBRATION)
        u, v = cloud.pixels.T  # type: ignore[union-attr]
        offset = (cloud.points - truth[v, u]) * np.sign(cloud.points[:, 2:] - truth[v, u, 2:])
        along = np.linalg.norm(offset, axis=1) * np.sign(cloud.points[:, 2] - truth[v, u, 2])
        errors.append(along / cloud.sigma_noise_mm)
        sigmas.append(cloud.sigma_noise_mm)
    assert np.std(np.concatenate(errors)) == pytest.approx(1.0, rel=0.1)
    assert 0.005 < np.median(np.concatenate(sigmas)) < 0.1


def test_the_axis_with_less_noise_counts_more() -> None:
    """A coarse second axis must not spoil a fine first one, and sigma must say what comes out."""
    truth, scatter = plane(), {}
    for axes, ratio in (("x", 1.0), ("xy", 20.0)):
        random = np.random.default_rng(5)
        clean = maps_of(truth, axes)
        noise_u, noise_v = (
            random.normal(0, 0.05 * k, truth.shape[:2]).astype(np.float32) for k in (1, ratio)
        )
        noisy = Maps(clean.u + noise_u, clean.v + noise_v, np.full_like(clean.sigma, 0.05), ratio)
        cloud = triangulate(noisy, CALIBRATION)
        u, v = cloud.pixels.T  # type: ignore[union-attr]
        along = (cloud.points - truth[v, u])[:, 2] * np.linalg.norm(truth[v, u], axis=1) / truth[v, u, 2]
        assert np.std(along / cloud.sigma_noise_mm) == pytest.approx(1.0, rel=0.1)
        scatter[axes] = np.std(along)
    assert scatter["xy"] <= 1.01 * scatter["x"]


def test_epipolar_distance_is_the_noise_across_the_epipolar_curve() -> None:
    cloud = triangulate(maps_of(plane(), noise_px=0.05), CALIBRATION)
    assert cloud.epipolar_px is not None
    assert np.sqrt(np.mean(cloud.epipolar_px**2)) == pytest.approx(0.05, rel=0.1)
    assert triangulate(maps_of(plane()), CALIBRATION).epipolar_px.max() < 1e-3  # type: ignore[union-attr]
    assert triangulate(maps_of(plane(), "x"), CALIBRATION).epipolar_px is None


def test_normals_of_a_plane_face_the_camera() -> None:
    cloud = triangulate(maps_of(plane()), CALIBRATION)
    expected = -np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])
    assert np.abs(cloud.normals - expected).max() < 2e-4
    assert triangulate(maps_of(plane()), CALIBRATION, normals=False).normals is None


def test_normals_do_not_mix_the_two_sides_of_a_jump() -> None:
    cloud = triangulate(maps_of(step()), CALIBRATION)
    assert np.abs(cloud.normals - [0.0, 0.0, -1.0]).max() < 1e-3


def test_grid_mesh_is_cut_at_a_jump_and_only_there() -> None:
    truth = step()
    maps = maps_of(truth)
    cloud = triangulate(maps, CALIBRATION)
    vertices, faces = cloud.grid_mesh()
    depths = vertices[faces][..., 2]
    assert np.ptp(depths, axis=1).max() < 1.0
    measured = np.isfinite(maps.u)
    same = np.abs(truth[..., 2] - 450.0) < 1.0
    whole = measured[:-1, :-1] & measured[1:, :-1] & measured[:-1, 1:] & measured[1:, 1:]
    left = same[:-1, :-1] & same[1:, :-1] & same[:-1, 1:] & same[1:, 1:]
    right = ~(same[:-1, :-1] | same[1:, :-1] | same[:-1, 1:] | same[1:, 1:])
    assert len(faces) >= 2 * (whole & (left | right)).sum()
    corners = vertices[faces]
    towards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", towards, corners[:, 0]) < 0.0).all()


@pytest.mark.whole
def test_quadric_distance_is_zero_on_a_sphere_and_the_noise_on_a_rough_plane() -> None:
    smooth = local_quadric_distance(triangulate(maps_of(sphere()), CALIBRATION))
    assert np.nanmedian(np.abs(smooth)) < 1e-3
    assert np.nanmax(np.abs(smooth)) < 0.03  # where half a window of 15 mm is all there is
    noisy = triangulate(maps_of(plane(), noise_px=0.05), CALIBRATION)
    rough = local_quadric_distance(noisy)
    truth = np.array([0.3, -0.2, 1.0])
    across = -(noisy.points @ truth - 450.0) / np.linalg.norm(truth)
    kept = np.isfinite(rough)
    assert kept.mean() > 0.9
    assert np.std(rough[kept]) == pytest.approx(np.std(across[kept]), rel=0.1)
    assert np.corrcoef(rough[kept], across[kept])[0, 1] > 0.9


def test_coordinates_outside_the_projector_are_dropped() -> None:
    maps = maps_of(plane())
    maps.u[30, 40] = 915.0
    cloud = triangulate(maps, CALIBRATION)
    kept = {tuple(p) for p in cloud.pixels.tolist()}  # type: ignore[union-attr]
    assert (40, 30) not in kept
    assert (41, 30) in kept
    assert len(cloud) == np.isfinite(maps.u).sum() - 1


def test_rays_that_part_before_the_camera_are_dropped() -> None:
    """Seen from the other side the projector's rays meet the camera's behind it."""
    pose = CALIBRATION.T_projector_camera
    mirrored = replace(CALIBRATION, T_projector_camera=RigidTransform(pose.rotation, -pose.translation))
    with pytest.raises(DataError, match="no pixel triangulates"):
        triangulate(maps_of(plane()), mirrored)


def test_two_axes_need_both_coordinates() -> None:
    maps = maps_of(plane())
    maps.v[10:20, 30:40] = np.nan
    cloud = triangulate(maps, CALIBRATION)
    u, v = cloud.pixels.T  # type: ignore[union-attr]
    assert not ((v >= 10) & (v < 20) & (u >= 30) & (u < 40)).any()


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("share", [0.02, 0.5, 0.98])
def test_scattered_pixels_without_coordinates_give_no_points(share: float, nothing: float) -> None:
    truth, maps = plane(), maps_of(plane())
    lost = np.random.default_rng(0).random((H, W)) < share
    maps.u[lost] = nothing
    cloud = triangulate(maps, CALIBRATION)
    assert len(cloud) == np.count_nonzero(np.isfinite(maps.u))
    u, v = cloud.pixels.T  # type: ignore[union-attr]
    assert not lost[v, u].any()
    assert np.abs(cloud.points - truth[v, u]).max() < MICRON


def test_texture_becomes_the_points_grey() -> None:
    texture = np.arange(W * H, dtype=np.uint32).reshape(H, W).astype(np.uint8)
    cloud = triangulate(maps_of(plane()), CALIBRATION, texture)
    u, v = cloud.pixels.T  # type: ignore[union-attr]
    assert (cloud.colour == texture[v, u]).all()
    with pytest.raises(DataError, match="texture"):
        triangulate(maps_of(plane()), CALIBRATION, texture[:-1])


def test_maps_of_another_camera_or_without_coordinates_are_refused() -> None:
    maps = maps_of(plane())
    with pytest.raises(CalibrationError, match="characterise this rig"):
        triangulate(Maps(maps.u[:-1], maps.v[:-1], maps.sigma[:-1]), CALIBRATION)
    nothing = np.full((H, W), np.nan, np.float32)
    with pytest.raises(DataError, match="no pixel has"):
        triangulate(Maps(nothing, nothing, nothing), CALIBRATION)


def test_fringes_along_the_baseline_are_refused() -> None:
    apart = Calibration(CAMERA, CAMERA, RigidTransform(np.eye(3), np.array([0.0, 100.0, 0.0])), {})
    plain = replace(CAMERA, distortion=np.zeros(5))
    apart = replace(apart, camera=plain, projector=plain)
    u = np.tile(np.arange(W, dtype=np.float32), (H, 1))
    with pytest.raises(DataError, match="across the baseline"):
        triangulate(Maps(u, np.full_like(u, np.nan), np.ones_like(u)), apart)
