"""SMCD against its definition; visibility, surfaces and alignment against analytic scenes."""

import sys
from dataclasses import replace

import igl
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from fpplab import artefacts
from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison import compare, mcd, smcd
from fpplab.comparison.alignment import AlignmentMesh, align_mesh, refine_pose
from fpplab.comparison.neighbours import nearest_neighbours
from fpplab.comparison.surfaces import distance_to_surface
from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.reconstruction.triangulation import camera_slopes

Array = NDArray[np.float64]

W, H = 200, 150
CAMERA = Pinhole.from_focal((W, H), (480.0, 480.0), (99.5, 74.5), (-0.1, 0.05, 0.0, 0.0, 0.0))
PROJECTOR = Pinhole.from_focal((400, 400), (900.0, 900.0), (199.5, 199.5))
PLACE = np.array([-150.0, 0.0, 0.0])
TILT = RigidTransform.from_vectors(np.array([0.0, -np.arctan2(150.0, 450.0), 0.0]), np.zeros(3))
CALIBRATION = Calibration(CAMERA, PROJECTOR, RigidTransform(TILT.rotation, -TILT.rotation @ PLACE), {})
# Artefacts stand with z towards the camera, their base 450 mm away.
BEFORE_CAMERA = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 450], [0, 0, 0, 1]])


def test_a_large_part_is_sampled_more_coarsely(monkeypatch: pytest.MonkeyPatch) -> None:
    plate = trimesh.creation.box((30, 20, 1)).apply_translation((0, 0, 400.5))
    points = np.random.default_rng(1).uniform((-15, -10, 400), (15, 10, 400), (500, 3))
    cloud = Cloud(points.astype(np.float32))
    fine = compare(cloud, plate)
    module = sys.modules[compare.__module__]
    monkeypatch.setattr(module, "LIMITS", replace(module.LIMITS, max_samples=30_000))
    coarse = compare(cloud, plate)
    assert fine.density_per_mm2 == 200.0
    assert coarse.density_per_mm2 == pytest.approx(50.0)
    assert coarse.surface_rms_um == fine.surface_rms_um
    assert coarse.smcd_um == pytest.approx(fine.smcd_um, rel=0.1)


def placed(name: str) -> trimesh.Trimesh:
    return artefacts.make(name).apply_transform(BEFORE_CAMERA)


def perfect_cloud(mesh: trimesh.Trimesh, noise_mm: float = 0.0, lit: bool = True) -> Cloud:
    """What an ideal bench measures: the first hit of every pixel's ray that the projector reaches."""
    a, b = camera_slopes(CAMERA)
    rays = np.stack([a, b, np.ones_like(a)], axis=-1).reshape(-1, 3)
    lengths = np.linalg.norm(rays, axis=1)
    shape = RayTracedShape(mesh)
    depth = shape.depth(np.zeros(3), rays / lengths[:, None])
    hit = np.flatnonzero(np.isfinite(depth))
    points = rays[hit] * (depth[hit] / lengths[hit])[:, None]
    if lit:
        seen = shape.unoccluded(CALIBRATION.projector_centre, points)
        hit, points = hit[seen], points[seen]
    points = points * (1.0 + np.random.default_rng(0).normal(0.0, noise_mm, len(points)) / 450.0)[:, None]
    pixels = np.stack([hit % W, hit // W], axis=1).astype(np.int32)
    sigma = np.full(len(points), noise_mm, np.float32)
    return Cloud(points.astype(np.float32), pixels, (W, H), sigma_noise_mm=sigma)


def brute_force(queries: Array, points: Array) -> Array:
    return np.asarray(np.sqrt(((queries[:, None] - points[None]) ** 2).sum(axis=2)).min(axis=1))


SHAPES = {
    "surface": lambda r, n: np.c_[r.uniform(-9, 9, (n, 2)), r.normal(450, 0.1, n)],
    "volume": lambda r, n: r.random((n, 3)),
    "clusters": lambda r, n: r.normal(0, 1, (n, 3)) ** 7,
    "line": lambda r, n: np.outer(r.random(n), [1.0, 2.0, 3.0]),
    "one place": lambda r, n: np.ones((n, 3)),
    "far away": lambda r, n: np.c_[r.uniform(-9, 9, (n, 2)), r.normal(999, 0.1, n)],
}


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(sorted(SHAPES)),
    st.sampled_from(sorted(SHAPES)),
    st.integers(1, 300),
    st.integers(1, 300),
    st.integers(0, 1000),
)
def test_nearest_and_smcd_are_those_of_their_definition(
    first: str, second: str, n: int, m: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    a, b = SHAPES[first](random, n), SHAPES[second](random, m)
    there, back = brute_force(a, b), brute_force(b, a)
    distance, index = nearest_neighbours(a, b)
    assert distance == pytest.approx(there, rel=1e-9, abs=1e-12)
    assert np.linalg.norm(a - b[index], axis=1) == pytest.approx(there, rel=1e-9, abs=1e-12)
    assert mcd(a, b) == pytest.approx(there.mean(), rel=1e-9, abs=1e-12)
    assert smcd(a, b) == pytest.approx((there.mean() + back.mean()) / 2, rel=1e-9, abs=1e-12)


def test_smcd_is_symmetric_and_zero_for_equal_sets() -> None:
    random = np.random.default_rng(0)
    a, b = random.random((500, 3)), random.random((400, 3))
    assert smcd(a, b) == smcd(b, a)
    assert smcd(a, a) == 0.0
    with pytest.raises(DataError, match="points"):
        smcd(a, np.empty((0, 3)))


def test_distance_to_a_pixel_surface_is_that_of_a_tree() -> None:
    cloud = perfect_cloud(placed("pyramid"), noise_mm=0.05)
    vertices, faces = cloud.grid_mesh()
    queries = np.random.default_rng(1).choice(vertices.astype(np.float64), 2000)
    queries = queries + np.random.default_rng(2).normal(0.0, 0.2, queries.shape)
    expected = np.sqrt(
        igl.point_mesh_squared_distance(queries, vertices.astype(np.float64), faces.astype(np.int64))[0]
    )
    found = distance_to_surface(queries, vertices.astype(np.float64), faces)
    assert (found >= expected - 1e-9).all()
    assert np.mean(found - expected) < 0.001 * expected.mean()


def test_box_shades_what_lies_behind_it_for_the_projector() -> None:
    """A box of height h on a plane 450 away throws a shadow of h·(x + 150)/(450 - h) beyond its edge x."""
    ground = trimesh.creation.box((100.0, 60.0, 2.0)).apply_translation([0, 0, 451.0])
    height = 30.0
    box = trimesh.creation.box((20.0, 40.0, height - 0.1)).apply_translation([0, 0, 450.0 - height / 2])
    shape = RayTracedShape(trimesh.util.concatenate([ground, box]))
    x = np.linspace(10.5, 40.0, 600)
    points = np.stack([x, np.zeros_like(x), np.full_like(x, 450.0)], axis=1)
    lit = shape.unoccluded(CALIBRATION.projector_centre, points)
    end = 10.0 + (height - 0.05) * 160.0 / (450.0 - height + 0.05)
    assert (lit == (x > end))[np.abs(x - end) > 0.1].all()
    assert not lit.all()
    assert lit.any()


def test_inclination_and_facing_are_those_of_the_view() -> None:
    plate = trimesh.creation.box((10.0, 10.0, 2.0)).apply_translation([100.0, 0.0, 301.0])
    shape = RayTracedShape(plate)
    front = np.flatnonzero(shape.normals[:, 2] < -0.9)[:1]
    angle = shape.inclination_deg(np.zeros(3), np.array([[100.0, 0.0, 300.0]]), front)
    assert angle[0] == pytest.approx(np.degrees(np.arctan2(100.0, 300.0)))
    facing = shape.facing(np.zeros(3))
    assert facing[shape.normals[:, 2] < -0.9].all()
    assert facing[shape.normals[:, 0] < -0.9].all()
    assert facing.sum() == 4


@pytest.mark.whole
@pytest.mark.parametrize("name", artefacts.NAMES)
def test_perfect_measurement_scores_the_floor_and_no_surface_distance(name: str) -> None:
    result = compare(perfect_cloud(placed(name)), placed(name), CALIBRATION, density=20.0)
    assert result.smcd_floor_um > 0.0
    assert result.smcd_um == pytest.approx(result.smcd_floor_um, rel=1e-3)
    assert result.surface_rms_um < 0.5
    assert result.surface_smcd_um is not None
    assert result.surface_smcd_um < 20.0  # pixels of 0.9 mm round the edges off
    assert result.completeness > 0.97
    assert result.outliers == 0
    assert result.restricted
    assert 0.25 < result.visible_share < 0.5


@pytest.mark.whole
def test_noise_shows_in_every_figure_as_it_should() -> None:
    noise = 0.08
    cloud = perfect_cloud(placed("pyramid"), noise)
    result = compare(cloud, placed("pyramid"), CALIBRATION, density=20.0)
    across = np.cos(np.arctan(20.0 / 27.0))
    assert noise * across * 1e3 * 0.9 < result.surface_rms_um < noise * 1e3 * 1.05
    assert result.surface_p95_um == pytest.approx(1.96 * result.surface_rms_um, rel=0.1)
    assert result.smcd_floor_um < result.smcd_um
    assert np.count_nonzero(result.distances_mm > 0) == pytest.approx(len(cloud) / 2, rel=0.1)


def test_signed_distances_are_positive_outside() -> None:
    mesh = placed("pyramid")
    cloud = perfect_cloud(mesh)
    nearer = replace(cloud, points=(cloud.points * np.float32(1 - 0.1 / 450)))
    assert (compare(nearer, mesh, CALIBRATION, density=5.0).distances_mm > 0).mean() > 0.99
    farther = replace(cloud, points=(cloud.points * np.float32(1 + 0.1 / 450)))
    assert (compare(farther, mesh, CALIBRATION, density=5.0).distances_mm < 0).mean() > 0.99


def test_outliers_are_counted_and_stay_in_the_mean() -> None:
    mesh = placed("steps")
    cloud = perfect_cloud(mesh)
    points = cloud.points.copy()
    points[:50] *= np.float32(400.0 / 450.0)
    result = compare(replace(cloud, points=points), mesh, CALIBRATION, density=5.0)
    clean = compare(cloud, mesh, CALIBRATION, density=5.0)
    assert result.outliers == 50
    assert result.points == clean.points
    assert result.smcd_um > clean.smcd_um + 0.5 * 50 / result.points * 10e3


def test_points_in_the_shadow_count_and_points_beside_the_part_do_not() -> None:
    mesh = placed("pillars")
    everywhere, lit = perfect_cloud(mesh, lit=False), perfect_cloud(mesh)
    assert compare(everywhere, mesh, CALIBRATION, density=5.0).points == len(everywhere) > len(lit)
    table = trimesh.creation.box((160.0, 110.0, 2.0)).apply_translation([0, 0, 451.001])
    around = perfect_cloud(trimesh.util.concatenate([mesh, table]))
    result = compare(around, mesh, CALIBRATION, density=5.0)
    assert result.off_part > 0
    assert result.summary()["beside"] == result.off_part
    assert result.points + result.off_part == len(around)
    assert result.surface_rms_um < 1.0


def test_missing_points_cost_completeness_by_their_share() -> None:
    mesh = placed("pyramid")
    cloud = perfect_cloud(mesh)
    keep = cloud.points[:, 0] < 0.0
    half = Cloud(cloud.points[keep], cloud.pixels[keep], cloud.size)  # type: ignore[index]
    result = compare(half, mesh, CALIBRATION, density=20.0)
    assert result.completeness == pytest.approx(0.5, abs=0.05)


def test_without_calibration_the_front_counts_and_the_result_says_so() -> None:
    mesh = placed("pyramid")
    result = compare(perfect_cloud(mesh, lit=False), mesh, density=5.0)
    assert not result.restricted
    assert result.summary()["restricted"] is False
    assert result.completeness > 0.95


@pytest.mark.parametrize("distance_mm", [500.0, 1e5])
def test_grazing_light_of_a_far_lamp_is_not_shaded_by_the_lit_face(distance_mm: float) -> None:
    convex = trimesh.creation.icosphere(2, 60.0).apply_translation([10.0, 0.0, 450.0])
    shape = RayTracedShape(convex)
    samples, faces = trimesh.sample.sample_surface(convex, 50_000, seed=2)
    towards = np.array([0.95, 0.25, -0.19]) / np.linalg.norm([0.95, 0.25, -0.19])
    lamp = np.array([0.0, 0.0, 450.0]) + distance_mm * towards
    lit = shape.unoccluded(lamp, samples)
    assert lit[shape.inclination_deg(lamp, samples, faces) < 89.0].all()


def test_what_lies_outside_of_the_images_is_told() -> None:
    aside = placed("pyramid").apply_translation([90.0, 0.0, 0.0])
    result = compare(perfect_cloud(aside), aside, CALIBRATION, density=2.0)
    assert 0.1 < result.out_of_view < 0.95
    assert any("lies outside of their images" in said for said in result.warnings())
    inside = compare(perfect_cloud(placed("pyramid")), placed("pyramid"), CALIBRATION, density=2.0)
    assert inside.out_of_view == 0.0
    assert inside.warnings() == []


def test_an_open_mesh_is_told() -> None:
    whole = placed("pyramid")
    hole = trimesh.Trimesh(whole.vertices, whole.faces[1:], process=False)
    result = compare(perfect_cloud(whole), hole, CALIBRATION, density=20.0)
    assert result.open_edges == 3
    assert "mesh: has 3 open edges" in result.warnings()[0]


def test_a_cloud_without_pixels_has_no_surface_figure() -> None:
    mesh = placed("pyramid")
    result = compare(Cloud(perfect_cloud(mesh).points), mesh, CALIBRATION, density=5.0)
    assert result.surface_smcd_um is None
    assert result.completeness > 0.5


@pytest.mark.whole
@pytest.mark.parametrize("name", ["pyramid", pytest.param("pillars", marks=pytest.mark.nightly)])
def test_alignment_finds_the_mesh_from_far(name: str) -> None:
    cloud = perfect_cloud(placed(name), 0.01)
    aligned = compare(cloud, artefacts.make(name), CALIBRATION, density=5.0, align=True)
    still = compare(cloud, placed(name), CALIBRATION, density=5.0)
    assert aligned.alignment is not None
    assert aligned.surface_rms_um < 1.1 * still.surface_rms_um
    assert aligned.alignment.transform.translation[2] == pytest.approx(450.0, abs=0.05)
    assert set(aligned.alignment.summary()) == {"rotation_deg", "translation_mm", "rms_um", "iterations"}


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [6, pytest.param(22, marks=pytest.mark.nightly)])
def test_alignment_does_not_take_the_wrong_side_of_a_plate(seed: int) -> None:
    """With these seeds the axes alone bring the cloud nearer to the plate's back, from every side."""
    cloud = perfect_cloud(placed("pillars"), 0.03).points.astype(np.float64)
    found = align_mesh(cloud, artefacts.make("pillars"), seed)
    assert found.rms_um < 40
    np.testing.assert_allclose(found.transform.translation, [0, 0, 450], atol=0.05)


@pytest.mark.parametrize(("off_mm", "rounds", "iterations"), [(0.0, 5, 1), (0.5, 1, 1)])
def test_refinement_counts_its_iterations(off_mm: float, rounds: int, iterations: int) -> None:
    """One finds that nothing is to be changed; no more than the rounds that are granted."""
    mesh = placed("pyramid")
    points, target = perfect_cloud(mesh).points.astype(np.float64), AlignmentMesh(mesh)
    start = RigidTransform(np.eye(3), np.array([0.0, 0.0, off_mm]))
    assert refine_pose(points, target, start, rounds)[1] == iterations


@pytest.mark.whole
def test_alignment_corrects_a_small_motion_exactly() -> None:
    mesh = placed("pillars")
    motion = RigidTransform.from_vectors(np.array([0.01, -0.02, 0.015]), np.array([0.5, -0.4, 0.3]))
    middle = RigidTransform(np.eye(3), np.array([0.0, 0.0, 440.0]))
    motion = middle @ motion @ middle.inverse()
    moved = mesh.copy().apply_transform(motion.matrix)
    found = align_mesh(perfect_cloud(mesh).points.astype(np.float64), moved)
    rest = found.transform @ motion
    assert np.degrees(np.linalg.norm(rest.rotation_vector)) < 0.01
    assert np.abs(rest.apply(mesh.vertices) - mesh.vertices).max() < 0.01


@pytest.mark.nightly
def test_alignment_finds_a_printed_part_from_far() -> None:
    """The grooves between its layers have undersides, which say nothing about the side that is seen."""
    printed = artefacts.slice_as_printed(artefacts.make("pyramid"), 0.4, 0.06)
    true = RigidTransform.from_vectors(np.array([np.pi, 0.0, 0.0]), np.array([0.0, 0.0, 460.0]))
    cloud = perfect_cloud(printed.copy().apply_transform(true.matrix), 0.03)
    found = align_mesh(cloud.points.astype(np.float64), printed).transform
    towards = found.rotation @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(towards, [0, 0, -1], atol=2e-3)
    np.testing.assert_allclose(found.translation, true.translation, atol=0.1)


@pytest.mark.whole
def test_alignment_to_something_else_is_refused() -> None:
    ball = np.random.default_rng(0).normal(size=(3000, 3))
    ball = 200.0 * ball / np.linalg.norm(ball, axis=1)[:, None] + [0, 0, 600]
    with pytest.raises(DataError, match="no pose"):
        align_mesh(ball, artefacts.make("steps"))


def test_what_cannot_be_compared_is_refused() -> None:
    mesh = placed("pyramid")
    cloud = perfect_cloud(mesh)
    with pytest.raises(ConfigError, match="density"):
        compare(cloud, mesh, CALIBRATION, density=0.0)
    with pytest.raises(ConfigError, match="near_mm"):
        compare(cloud, mesh, CALIBRATION, near_mm=float("nan"))
    inside_out = mesh.copy()
    inside_out.invert()
    with pytest.raises(DataError, match="inwards"):
        compare(cloud, inside_out, CALIBRATION)
    with pytest.raises(DataError, match=r"faces both|nothing of it"):
        compare(cloud, artefacts.make("pyramid").apply_translation([0, 0, -900]), CALIBRATION, density=5.0)
