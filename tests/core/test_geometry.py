"""Rigid transforms as a group, and the pinhole against its own inverse and OpenCV."""

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fpplab.core.conventions import Floats
from fpplab.core.geometry import Pinhole, RigidTransform, distort

VECTORS = arrays(np.float64, 3, elements=st.floats(-3.0, 3.0))
SHIFTS = arrays(np.float64, 3, elements=st.floats(-500.0, 500.0))
TRANSFORMS = st.builds(RigidTransform.from_vectors, VECTORS, SHIFTS)
POINTS = arrays(np.float64, (4, 3), elements=st.floats(-500.0, 500.0))

CAMERA = Pinhole.from_focal((1368, 912), (3645.0, 3640.0), (683.5, 455.5), (-0.12, 0.2, 1e-3, -8e-4, 0.05))

MILD = (-0.12, 0.2, 1e-3, -8e-4, 0.05)
WIDE = (0.5, 0.1, 4e-4, -3e-4, 0.01, 0.9, 0.3, 0.02)


def wide(lens: tuple[float, ...]) -> Pinhole:
    """81 degrees across."""
    return Pinhole.from_focal((1200, 900), (700, 698), (610, 440), lens)


def same(a: RigidTransform, b: RigidTransform) -> None:
    np.testing.assert_allclose(a.matrix, b.matrix, atol=1e-9)


@given(TRANSFORMS, TRANSFORMS, TRANSFORMS)
def test_composition_is_associative(a: RigidTransform, b: RigidTransform, c: RigidTransform) -> None:
    same((a @ b) @ c, a @ (b @ c))


@given(TRANSFORMS)
def test_identity_and_inverse(a: RigidTransform) -> None:
    same(a @ RigidTransform.identity(), a)
    same(RigidTransform.identity() @ a, a)
    same(a @ a.inverse(), RigidTransform.identity())
    same(a.inverse() @ a, RigidTransform.identity())
    same(a.inverse().inverse(), a)


@given(TRANSFORMS, TRANSFORMS, POINTS)
def test_composition_is_one_after_the_other(a: RigidTransform, b: RigidTransform, points: Floats) -> None:
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=1e-8)


@given(TRANSFORMS, SHIFTS)
def test_to_move_is_to_shift_in_the_outer_frame(a: RigidTransform, by: Floats) -> None:
    same(a.moved(by), RigidTransform(np.eye(3), by) @ a)


@given(TRANSFORMS, POINTS)
def test_distances_and_handedness_are_kept(a: RigidTransform, points: Floats) -> None:
    moved = a.apply(points)
    np.testing.assert_allclose(
        np.linalg.norm(moved - moved[0], axis=1), np.linalg.norm(points - points[0], axis=1), atol=1e-8
    )
    assert np.linalg.det(a.rotation) == pytest.approx(1.0)


@given(TRANSFORMS, POINTS)
def test_the_matrix_does_the_same(a: RigidTransform, points: Floats) -> None:
    homogeneous = np.column_stack([points, np.ones(4)])
    np.testing.assert_allclose((homogeneous @ a.matrix.T)[:, :3], a.apply(points), atol=1e-9)


@given(TRANSFORMS)
def test_the_rotation_vector_makes_the_same_rotation(a: RigidTransform) -> None:
    same(RigidTransform.from_vectors(a.rotation_vector, a.translation), a)


def test_a_quarter_turn_about_z_takes_x_to_y() -> None:
    turn = RigidTransform.from_vectors(np.array([0, 0, np.pi / 2]), np.array([10.0, 0, 0]))
    np.testing.assert_allclose(turn.apply(np.array([1.0, 0, 0])), [10, 1, 0], atol=1e-15)


def test_points_keep_their_shape() -> None:
    grid = np.zeros((2, 5, 3))
    assert RigidTransform.identity().apply(grid).shape == (2, 5, 3)
    assert CAMERA.project(grid + [0, 0, 1]).shape == (2, 5, 2)
    assert CAMERA.normalise(np.zeros((2, 5, 2))).shape == (2, 5, 2)


@pytest.mark.parametrize("lens", [MILD, WIDE], ids=["five", "eight"])
def test_projection_is_opencvs(lens: tuple[float, ...]) -> None:
    device = wide(lens)
    points = np.random.default_rng(0).uniform((-90, -60, 80), (90, 60, 120), (500, 3))
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), device.matrix, np.array(lens))
    np.testing.assert_allclose(device.project(points), expected[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("lens", [MILD, WIDE], ids=["five", "eight"])
def test_derivatives_are_those_of_the_distortion(lens: tuple[float, ...]) -> None:
    x, y = np.random.default_rng(1).uniform(-0.8, 0.8, (2, 200))
    d, step = wide(lens).distortion, 1e-6
    _, _, xx, xy, yy = distort(x, y, d)
    by_x, by_y = (
        (np.array(distort(x + a, y + b, d)[:2]) - distort(x - a, y - b, d)[:2]) / (2 * step)
        for a, b in ((step, 0), (0, step))
    )
    np.testing.assert_allclose([[xx, xy], [xy, yy]], [by_x, by_y], rtol=0, atol=1e-8)


def test_five_coefficients_are_eight_with_zeros() -> None:
    assert wide(MILD).distortion.tolist() == [*MILD, 0, 0, 0]
    assert wide(MILD).coefficients.tolist() == [*MILD]
    assert wide(WIDE).distortion.tolist() == wide(WIDE).coefficients.tolist() == [*WIDE]
    assert not Pinhole.from_focal((8, 8), (9, 9), (3.5, 3.5)).distortion.any()


def test_the_axis_meets_the_principal_point() -> None:
    np.testing.assert_allclose(CAMERA.project(np.array([0.0, 0, 100])), [683.5, 455.5], atol=1e-10)


@given(st.floats(0, 1367), st.floats(0, 911), st.floats(50.0, 2000.0))
def test_projection_undoes_normalising(u: float, v: float, depth: float) -> None:
    slopes = CAMERA.normalise(np.array([u, v]))
    ray = np.append(slopes, 1.0) * depth
    np.testing.assert_allclose(CAMERA.project(ray), [u, v], atol=1e-6)


@given(st.floats(-0.18, 0.18), st.floats(-0.12, 0.12))
def test_normalising_undoes_projection(x: float, y: float) -> None:
    pixels = CAMERA.project(np.array([x, y, 1.0]))
    np.testing.assert_allclose(CAMERA.normalise(pixels), [x, y], atol=1e-9)


small, gentle = st.floats(-0.4, 0.4), st.floats(-0.01, 0.01)
LENSES = st.one_of(
    st.tuples(small, small, gentle, gentle, small),
    st.tuples(small, small, gentle, gentle, small, st.floats(-0.4, 3.0), small, small),
)


@given(LENSES, st.floats(-0.5, 1199.5), st.floats(-0.5, 899.5))
def test_a_ray_of_a_wide_lens_meets_its_pixel(lens: tuple[float, ...], u: float, v: float) -> None:
    device = wide(lens)
    slopes = device.normalise(np.array([u, v]))
    if np.isfinite(slopes).all():
        assert np.hypot(*slopes) < device.reach
        np.testing.assert_allclose(device.project(np.append(slopes, 1.0)), [u, v], rtol=0, atol=1e-9)


@given(LENSES, st.floats(0, 2 * np.pi), st.floats(0, 0.9))
def test_every_pixel_within_reach_has_its_ray(lens: tuple[float, ...], angle: float, share: float) -> None:
    device = wide(lens)
    ray = share * min(device.reach, 1.1) * np.array([np.cos(angle), np.sin(angle)])
    _, _, xx, xy, yy = distort(*ray, device.distortion)
    assume(np.linalg.eigvalsh([[xx, xy], [xy, yy]])[0] > 0.05)  # p1, p2 may fold a little earlier
    found = device.normalise(device.project(np.append(ray, 1.0)))
    np.testing.assert_allclose(found, ray, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "lens",
    [
        (-0.03, 0.5, 0.0, 0.0, -0.22, -0.43, -0.43, 0.37),
        (-0.3, 0.0, 0.0, 0.0, 0.0),
    ],
)
def test_every_pixel_just_within_the_reach_has_its_ray(lens: tuple[float, ...]) -> None:
    """Where the distorted slope, from which the search begins, is far beyond the reach."""
    device = wide(lens)
    angle, share = np.meshgrid(np.linspace(0, 2 * np.pi, 40), np.linspace(0.8, 0.99, 20))
    rays = device.reach * share[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    pixels = device.project(np.concatenate([rays, np.ones((*share.shape, 1))], axis=-1))
    np.testing.assert_allclose(device.normalise(pixels), rays, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("lens", "reach"),
    [
        ((-0.3, 0.0, 0.0, 0.0, 0.0), np.sqrt(1 / 0.9)),  # d(r - 0.3 r³)/dr = 0
        ((0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0), 1.0),  # a pole
        ((-(1 / 0.81 + 1 / 1.96) / 3, 0.2 / (0.81 * 1.96), 0.0, 0.0, 0.0), 0.9),  # two folds: 0.9 and 1.4
        ((0.0, 0.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0), 0.5),  # d(r / (1 + 4 r²))/dr = 0
        ((0.2, 0.0, 0.0, 0.0, 0.0), np.inf),
        ((0.0,) * 8, np.inf),
    ],
)
def test_a_lens_reaches_to_its_fold_or_pole(lens: tuple[float, ...], reach: float) -> None:
    device = wide(lens)
    assert device.reach == pytest.approx(reach, rel=1e-12)
    pixels = np.stack(np.meshgrid(np.arange(0, 1200, 50.0), np.arange(0, 900, 50.0)), axis=-1)
    along = np.linspace(0, min(reach, 5), 100_001)[:-1]
    widest = distort(along, 0 * along, device.distortion)[0].max()
    distorted = np.hypot(*np.moveaxis((pixels - (610, 440)) / (700, 698), -1, 0))
    seen = np.isfinite(device.normalise(pixels)).all(axis=-1)
    np.testing.assert_array_equal(seen, distorted < widest)


@given(TRANSFORMS)
def test_a_pose_is_applied_before_projection(pose: RigidTransform) -> None:
    device_points = np.array([[10.0, 5.0, 400.0], [-30.0, 20.0, 500.0]])
    world_points = pose.inverse().apply(device_points)
    np.testing.assert_allclose(CAMERA.project(world_points, pose), CAMERA.project(device_points), atol=1e-6)


SQUARE = Pinhole.from_focal((64, 48), (64.0, 64.0), (31.5, 23.5))
"""Its slopes and pixels are exact in binary."""


@pytest.mark.parametrize(
    ("pixel", "margin", "seen"),
    [
        ((-0.5, -0.5), 0.0, True),
        ((63.5, 47.5), 0.0, True),
        ((63.75, 47.5), 0.0, False),
        ((63.5, 47.75), 0.0, False),
        ((0.0, 0.0), 0.5, True),
        ((-0.25, 0.0), 0.5, False),
        ((63.0, 47.25), 0.5, False),
    ],
)
def test_an_image_ends_at_the_outer_edges_of_its_pixels(
    pixel: tuple[float, float], margin: float, seen: bool
) -> None:
    point = 2.0 * np.append(SQUARE.normalise(np.array(pixel)), 1.0)
    assert SQUARE.sees(point, margin_px=margin) == seen


def test_nothing_behind_a_device_is_seen() -> None:
    np.testing.assert_array_equal(SQUARE.sees(np.array([[0, 0, 1.0], [0, 0, 0], [0, 0, -1.0]])), [1, 0, 0])


def test_a_ray_that_the_distortion_folds_back_is_not_seen() -> None:
    barrel = Pinhole.from_focal((64, 48), (64.0, 64.0), (31.5, 23.5), (-0.25, 0, 0, 0, 0))
    folded = np.array([2.0, 0.0, 1.0])  # where 1 + k1 r² is 0
    np.testing.assert_allclose(barrel.project(folded), [31.5, 23.5])
    np.testing.assert_array_equal(barrel.sees(np.array([folded, [0.1, 0.0, 1.0]])), [False, True])


@given(TRANSFORMS)
def test_a_pose_is_applied_before_looking(pose: RigidTransform) -> None:
    points = np.array([[10.0, 5.0, 400.0], [-30.0, 20.0, 500.0], [300.0, 0.0, 400.0], [0.0, 0.0, -400.0]])
    np.testing.assert_array_equal(CAMERA.sees(pose.inverse().apply(points), pose), [1, 1, 0, 0])


def test_a_part_of_the_image_has_the_same_rays() -> None:
    part = CAMERA.cropped((200, 30), (64, 48))
    assert part.size == (64, 48)
    points = np.random.default_rng(1).uniform((-20, -20, 400), (20, 20, 500), (50, 3))
    np.testing.assert_allclose(part.project(points) + (200, 30), CAMERA.project(points), rtol=1e-12)
    np.testing.assert_allclose(part.normalise(np.zeros((1, 2))), CAMERA.normalise(np.array([[200.0, 30.0]])))
