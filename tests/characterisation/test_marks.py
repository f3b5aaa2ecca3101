"""Reference marks beside what really changed: exact truths, with noise."""

from dataclasses import replace

import numpy as np
import pytest

from fpplab.calibration.board import LocatedMarks
from fpplab.calibration.changes import changed_rigs, parameter_vector
from fpplab.calibration.displacements import calibration_jacobian, displacements_by_mode
from fpplab.calibration.model import Calibration
from fpplab.characterisation import Observation
from fpplab.characterisation.marks import compare_marks, triangulate_marks
from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import RigidTransform
from fpplab.pipeline.marks import widened_by_marks
from fpplab.targets import Target
from tests.characterisation.test_judging import NOISE_PX, of_nine_poses
from tests.support.rigs import CAMERA, PAIR, SQUARE

TRUE = Calibration(CAMERA, SQUARE, PAIR, {})
TARGET = Target.load("target_marks")


def folded() -> Floats:
    """The sheet at a third of its size, of which the lower half lies nearer."""
    points = TARGET.points() / 3
    points[:, 2] = np.where(points[:, 1] > 0, -points[:, 1], 0.1 * points[:, 0]) + 290.0
    return points


def marks_seen(
    rig: Calibration, seed: int, points: Floats | None = None, noise: float = NOISE_PX
) -> Observation:
    points, random = folded() if points is None else points, np.random.default_rng(seed)
    camera, light = rig.camera.project(points), rig.projector.project(points, rig.T_projector_camera)
    off = random.normal(0, noise, (2, *camera.shape))
    return Observation("scan", np.arange(len(points)), camera + off[0], light + off[1])


@pytest.fixture
def calibration() -> Calibration:
    return of_nine_poses().calibration


@pytest.fixture(scope="module")
def located() -> LocatedMarks:
    then = marks_seen(TRUE, 100)
    return LocatedMarks(config.plain(TARGET), then.ids, then.camera_px, then.projector_px)


def test_marks_are_triangulated_where_they_are() -> None:
    then = marks_seen(TRUE, 0, noise=0.0)
    marks = LocatedMarks({}, then.ids, then.camera_px, then.projector_px)
    np.testing.assert_allclose(triangulate_marks(TRUE, marks), folded(), atol=1e-4)


@pytest.mark.parametrize("axes", [1, 2])
def test_marks_that_were_moved_as_a_whole_show_no_change(
    calibration: Calibration, located: LocatedMarks, axes: int
) -> None:
    moved = RigidTransform.from_vectors(np.radians([1.0, -2.0, 1.5]), np.array([3.0, -2.0, 6.0]))
    now = marks_seen(TRUE, 101, moved.apply(folded()))
    if axes == 1:
        now.projector_px[:, 1] = np.nan
    compared = compare_marks(calibration, located, now)
    assert not compared.contradicted
    assert compared.explained
    assert max(compared.probabilities.values()) < 0.2


@pytest.mark.parametrize(
    "name", ["the projector turned by 0.1° about its y axis", "the lens of the camera zoomed by 0.4 %"]
)
def test_a_change_is_shown_and_corrected(calibration: Calibration, located: LocatedMarks, name: str) -> None:
    now = changed_rigs(TRUE)[name]
    compared = compare_marks(calibration, located, marks_seen(now, 102))
    assert compared.contradicted
    assert compared.explained
    part = "projector or camera moved" if "turned" in name else "camera's lens or picture changed"
    assert compared.probabilities[part] > 0.8
    points = np.random.default_rng(1).uniform((-25, -20, 230), (25, 20, 270), (99, 3))
    jacobian = calibration_jacobian(points, TRUE, (1.0, 1.0))
    true = jacobian @ (parameter_vector(now) - parameter_vector(TRUE))
    off = np.sqrt(np.square(jacobian @ compared.change - true).sum(axis=1).mean())
    spread = np.sqrt(np.einsum("nip,pq,niq->", jacobian, compared.covariance, jacobian) / len(true))
    assert off < 2.5 * spread
    assert spread < np.sqrt(np.square(true).sum(axis=1).mean())
    fixed = jacobian @ (parameter_vector(now) - parameter_vector(compared.corrected))
    own = jacobian @ (parameter_vector(TRUE) - parameter_vector(calibration))
    assert np.square(fixed).mean() < 1.5 * np.square(own).mean() + 3 * spread**2


def test_points_that_something_hides_are_left_out(calibration: Calibration, located: LocatedMarks) -> None:
    now = marks_seen(TRUE, 103)
    now.camera_px[:12] += 1.5
    now.projector_px[20:28, 0] += 40.0
    compared = compare_marks(calibration, located, now)
    assert not compared.contradicted
    assert compared.as_characterised.poses[0].points == len(now.ids) - 20


def test_marks_that_moved_by_themselves_are_left_out(calibration: Calibration, located: LocatedMarks) -> None:
    now = marks_seen(TRUE, 104)
    now.camera_px[::2] += np.random.default_rng(0).uniform(-20, 20, (len(now.ids) // 2, 2))
    compared = compare_marks(calibration, located, now)
    assert not compared.contradicted
    assert compared.as_characterised.poses[0].points == len(now.ids) // 2


def test_few_points_in_view_are_refused(calibration: Calibration, located: LocatedMarks) -> None:
    now = marks_seen(TRUE, 105)
    few = Observation("scan", now.ids[:4], now.camera_px[:4], now.projector_px[:4])
    with pytest.raises(CalibrationError, match=r"4 points of the reference marks are in view \(at least 6\)"):
        compare_marks(calibration, located, few)


def test_marks_are_kept_with_the_calibration(
    calibration: Calibration, located: LocatedMarks, tmp_path: object
) -> None:
    file = f"{tmp_path}/calibration.yaml"
    replace(calibration, marks=located).save(file)
    kept = Calibration.load(file).marks
    assert kept is not None
    np.testing.assert_array_equal(kept.ids, located.ids)
    np.testing.assert_allclose(kept.camera_px, located.camera_px, atol=1e-5)
    assert config.validate(kept.target, Target, "marks") == TARGET


@pytest.mark.parametrize("name", ["the projector turned by 0.1° about its y axis", None])
def test_what_the_marks_show_is_part_of_the_uncertainty(
    calibration: Calibration, located: LocatedMarks, name: str | None
) -> None:
    now = changed_rigs(TRUE)[name] if name else TRUE
    compared = compare_marks(calibration, located, marks_seen(now, 106))
    points = np.random.default_rng(1).uniform((-25, -20, 230), (25, 20, 270), (99, 3))
    off = calibration_jacobian(points, TRUE, (1.0, 1.0)) @ (
        parameter_vector(now) - parameter_vector(calibration)
    )
    before, after = (
        np.linalg.norm(displacements_by_mode(points, known, (1.0, 1.0)))
        for known in (calibration, widened_by_marks(calibration, compared))
    )
    assert np.linalg.norm(off) < 2.0 * after
    assert after < 1.2 * before if name is None else after > 2.0 * before
