"""Rigid transforms as a group, and the pinhole against its own inverse and OpenCV's equations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fpplab.conventions import Floats
from fpplab.geometry import Pinhole, RigidTransform

VECTORS = arrays(np.float64, 3, elements=st.floats(-3.0, 3.0))
SHIFTS = arrays(np.float64, 3, elements=st.floats(-500.0, 500.0))
TRANSFORMS = st.builds(RigidTransform.from_vectors, VECTORS, SHIFTS)
POINTS = arrays(np.float64, (4, 3), elements=st.floats(-500.0, 500.0))

CAMERA = Pinhole.from_focal((1368, 912), (3645.0, 3640.0), (683.5, 455.5), (-0.12, 0.2, 1e-3, -8e-4, 0.05))


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


def test_projection_is_opencvs_equation() -> None:
    """x' = x(1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 xy + p2(r² + 2x²), and likewise y."""
    point = np.array([40.0, -25.0, 470.0])
    x, y = point[:2] / point[2]
    k1, k2, p1, p2, k3 = CAMERA.distortion
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    np.testing.assert_allclose(
        CAMERA.project(point), [3645.0 * xd + 683.5, 3640.0 * yd + 455.5], rtol=0, atol=1e-9
    )


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


@given(TRANSFORMS)
def test_a_pose_is_applied_before_projection(pose: RigidTransform) -> None:
    device_points = np.array([[10.0, 5.0, 400.0], [-30.0, 20.0, 500.0]])
    world_points = pose.inverse().apply(device_points)
    np.testing.assert_allclose(CAMERA.project(world_points, pose), CAMERA.project(device_points), atol=1e-6)
