"""The scale of a cloud and lengths of artefacts, against clouds whose scale, shear and noise are exact."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from fpplab import artefacts
from fpplab.artefacts.recognition import PlacedArtefact, recognise
from fpplab.calibration.model import PARAMETERS, Uncertainty
from fpplab.cli.every import app
from fpplab.clouds import Cloud, load_mesh, save_cloud
from fpplab.comparison import compare
from fpplab.comparison.alignment import AlignmentMesh
from fpplab.comparison.lengths import displacements_by, measure_lengths
from fpplab.comparison.scale import LIMITS, fit_scale
from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform
from tests.comparison.test_comparison import BEFORE_CAMERA, CALIBRATION, perfect_cloud, placed

SUPPLIED = ("pyramid", "pillars", "steps")
"""Artefacts whose shape shows the scale."""
WITH_LENGTHS = [name for name, shape in artefacts.artefact_types().items() if shape().lengths()]
NOISE_MM = 0.01
SEEDS = range(40, 65)
ZRMS = (0.55, 1.6)
"""Permitted root mean square of 25 deviations in standard uncertainties: the 99.9 % range of chi is 0.54 to
1.45; the rest is for the bias that edges leave."""


def noisy(points: Floats, seed: int, common_mm: float = 0.0, patch_mm: float = 4.0) -> Floats:
    """Points with noise along their rays: independent, and common to all points of a patch."""
    random = np.random.default_rng(seed)
    noise = random.normal(0.0, NOISE_MM, len(points))
    column, row = np.floor((points[:, :2] + 200.0) / patch_mm + random.random(2)).astype(int).T
    side = int(np.ceil(400.0 / patch_mm)) + 2
    noise += random.normal(0.0, 1.0, (side, side))[column, row] * common_mm
    return np.asarray(points * (1.0 + noise / np.linalg.norm(points, axis=1))[:, None])


def scaled(cloud: Cloud, ppm: Floats | float) -> Cloud:
    middle = cloud.points.mean(axis=0, dtype=np.float64)
    points = middle + (cloud.points - middle) * (1.0 + 1e-6 * np.asarray(ppm))
    return replace(cloud, points=points.astype(np.float32))


def in_artefact(points: Floats) -> tuple[Floats, Floats]:
    """Points, and the place of the camera, in the artefact's frame."""
    inverse = np.linalg.inv(BEFORE_CAMERA)
    return points @ inverse[:3, :3].T + inverse[:3, 3], inverse[:3, 3]


@pytest.mark.parametrize("ppm", [-1000.0, 300.0])
@pytest.mark.parametrize("name", SUPPLIED)
def test_scale_is_found_to_its_uncertainty(name: str, ppm: float) -> None:
    mesh = placed(name)
    cloud = scaled(perfect_cloud(mesh, NOISE_MM), ppm)
    found = fit_scale(cloud.points.astype(np.float64), AlignmentMesh(mesh))
    assert found is not None
    assert found.ppm == pytest.approx(ppm, abs=4 * found.sigma_ppm)
    assert found.sigma_ppm < 150
    assert found.effect_um == pytest.approx(abs(found.ppm) * 1e-3 * found.spread_mm)
    assert 30 < found.spread_mm < 36  # of a plate of 90 x 70 mm: 32.9


@pytest.mark.nightly
@pytest.mark.parametrize("common_mm", [0.0, 0.01])
@pytest.mark.parametrize("name", SUPPLIED)
def test_the_scale_s_uncertainty_covers_its_errors(name: str, common_mm: float) -> None:
    mesh = placed(name)
    points, target = perfect_cloud(mesh).points.astype(np.float64), AlignmentMesh(mesh)
    found = [fit_scale(noisy(points, seed, common_mm), target, seed) for seed in SEEDS]
    errors = np.array([one.ppm / one.sigma_ppm for one in found if one is not None])
    assert len(errors) == len(SEEDS)
    assert ZRMS[0] < np.sqrt(np.mean(errors**2)) < ZRMS[1]


def test_a_plane_and_a_single_sphere_have_no_scale() -> None:
    plate = trimesh.creation.box((80.0, 60.0, 2.0)).apply_translation([0, 0, 451.0])
    assert fit_scale(noisy(perfect_cloud(plate).points.astype(np.float64), 0), AlignmentMesh(plate)) is None
    few = perfect_cloud(placed("pyramid")).points[:10].astype(np.float64)
    assert fit_scale(few, AlignmentMesh(placed("pyramid"))) is None
    assert LIMITS.cells_across >= 8


@pytest.mark.nightly
@pytest.mark.parametrize("name", WITH_LENGTHS)
def test_lengths_are_measured_to_their_uncertainty(name: str) -> None:
    shape = artefacts.artefact_types()[name]()
    true = shape.lengths()
    assert true
    points = perfect_cloud(placed(name), lit=False).points.astype(np.float64)
    errors = []
    for seed in SEEDS[:10]:
        for found in measure_lengths(*in_artefact(noisy(points, seed, 0.01, 2.0)), true):
            if found.error_um is not None:
                assert found.sigma_um is not None
                assert found.sigma_um < 40
                errors.append(found.error_um / found.sigma_um)
    assert len(errors) >= 10 * (len(true) // 2)
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.6


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("name", WITH_LENGTHS)
def test_true_lengths_are_those_of_the_mesh(name: str) -> None:
    """Without noise the features fitted to the mesh's own surface give the stated values."""
    shape = artefacts.artefact_types()[name]()
    surface = np.asarray(trimesh.sample.sample_surface(artefacts.make(name), 80_000, seed=1)[0], np.float64)
    for found in measure_lengths(surface, np.array([0.0, 0.0, 450.0]), shape.lengths()):
        assert found.measured_mm == pytest.approx(found.true_mm, abs=1e-3 if name == "ball_bar" else 1e-6)


@pytest.mark.whole
def test_a_scale_error_is_told_where_the_distance_hides_it() -> None:
    """Distances rise by less than a fifth, while the points are moved by 66 µm."""
    artefact = recognise(artefacts.make("steps"))
    cloud = perfect_cloud(placed("steps"), 0.03)
    right = compare(
        cloud, placed("steps"), CALIBRATION, density=2.0, align=True, artefact=recognise(placed("steps"))
    )
    wrong = compare(
        scaled(cloud, 2000.0),
        artefacts.make("steps"),
        CALIBRATION,
        density=2.0,
        align=True,
        artefact=artefact,
    )
    assert wrong.surface_rms_um < 1.2 * right.surface_rms_um
    assert right.warnings() == []
    assert wrong.scale is not None
    assert any(f"scale: the cloud is {wrong.scale.ppm:.0f} ±" in said for said in wrong.warnings())
    assert [m.name for m in wrong.lengths][-1] == "step height 1 to 5"
    last = wrong.lengths[-1]
    assert last.error_um == pytest.approx(40.0, abs=4 * (last.sigma_um or 0.0))
    assert any(said.startswith("step height 1 to 5: measures 20.0") for said in wrong.warnings())
    plain = wrong.summary()
    assert plain["warnings"] == wrong.warnings()
    assert plain["lengths"][-1]["true_mm"] == 20.0  # type: ignore[index]


@pytest.mark.whole
def test_shear_shows_in_the_diagonals_of_the_pyramid() -> None:
    """A shear of 1e-3 within the plate leaves sides as they are and changes 100 mm of diagonal by ± 48 µm."""
    points, camera = in_artefact(noisy(perfect_cloud(placed("pyramid")).points.astype(np.float64), 3))
    points[:, 0] += 1e-3 * points[:, 1]
    found = {
        m.name: m for m in measure_lengths(points, camera, artefacts.artefact_types()["pyramid"]().lengths())
    }
    for name, expected in (
        ("foot diagonal 1", 48.0),
        ("foot diagonal 2", -48.0),
        ("foot along x, -y side", 0.0),
    ):
        error, sigma = found[name].error_um, found[name].sigma_um
        assert error == pytest.approx(expected, abs=4 * (sigma or 0.0) + 0.1)
        assert sigma is not None
        assert sigma < 10


def test_a_board_of_uncertain_size_makes_lengths_uncertain() -> None:
    """An error of the board's size by a share lengthens the baseline and every length by as much."""
    lengths, baseline = (
        artefacts.artefact_types()["steps"]().lengths(),
        CALIBRATION.T_projector_camera.translation,
    )
    uncertainty = Uncertainty(PARAMETERS[-3:], np.outer(baseline, baseline) * 1e-3**2 + 1e-18 * np.eye(3))
    points, camera = in_artefact(perfect_cloud(placed("steps")).points.astype(np.float64))
    sized = displacements_by(
        replace(CALIBRATION, uncertainty=uncertainty),
        RigidTransform(BEFORE_CAMERA[:3, :3], BEFORE_CAMERA[:3, 3]),
    )
    for one in measure_lengths(points, camera, lengths, sized):
        assert one.sigma_calibration_um == pytest.approx(one.true_mm, rel=0.01)
        assert (one.sigma_um or 0.0) >= one.sigma_calibration_um


def test_lengths_that_are_not_measured_are_told() -> None:
    points, camera = in_artefact(perfect_cloud(placed("steps")).points.astype(np.float64))
    lengths = artefacts.artefact_types()["steps"]().lengths()
    found = measure_lengths(points[points[:, 0] < 20.0], camera, lengths)
    assert [m.measured_mm is None for m in found] == [False, False, False, True, True]
    assert (found[-1].error_um, found[-1].sigma_um, found[-1].significant) == (None, None, False)


def test_without_alignment_there_is_neither_scale_nor_length() -> None:
    mesh = placed("pyramid")
    found = compare(perfect_cloud(mesh), mesh, CALIBRATION, density=2.0, artefact=recognise(mesh))
    assert (found.scale, found.lengths, found.warnings()) == (None, (), [])


@pytest.mark.whole
@pytest.mark.parametrize("name", artefacts.artefact_types())
def test_an_artefact_is_recognised_wherever_it_stands(name: str, tmp_path: Path) -> None:
    pose = RigidTransform.from_vectors(np.array([0.4, -2.0, 0.3]), np.array([10.0, -20.0, 450.0]))
    artefacts.save_stl(artefacts.make(name).apply_transform(pose.matrix), tmp_path / "part.stl")
    found = recognise(load_mesh(tmp_path / "part.stl"))
    assert isinstance(found, PlacedArtefact)
    assert type(found.artefact) is artefacts.artefact_types()[name]
    np.testing.assert_allclose(found.pose.matrix, pose.matrix, atol=1e-4)


@pytest.mark.whole
def test_the_command_gives_scale_lengths_and_warnings(tmp_path: Path) -> None:
    save_cloud(scaled(perfect_cloud(placed("steps"), 0.03), 3000.0), tmp_path / "cloud.ply")
    artefacts.save_stl(artefacts.make("steps"), tmp_path / "steps.stl")
    words = ["compare", str(tmp_path / "cloud.ply"), str(tmp_path / "steps.stl"), "--align"]
    done = CliRunner().invoke(app, [*words, "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["scale"]["ppm"] == pytest.approx(3000, abs=4 * found["scale"]["sigma_ppm"])
    assert len(found["lengths"]) == 5
    assert len(found["warnings"]) >= 2
    shown = CliRunner().invoke(app, words)
    assert "step height 1 to 5" in shown.stdout
    assert "ppm" in shown.stdout


@pytest.mark.whole
def test_another_part_is_not_recognised() -> None:
    assert recognise(artefacts.make("steps", {"heights": (5.0, 10.0, 15.0, 20.0, 25.1)})) is None
    assert recognise(trimesh.creation.box((10.0, 20.0, 30.0))) is None
