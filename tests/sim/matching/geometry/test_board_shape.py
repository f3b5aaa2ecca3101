"""The bend of the bench's board, and what its points tell of a geometry beside its images."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from fpplab.calibration.model import Calibration
from fpplab.characterisation import DistortionModel, characterise
from fpplab.characterisation.parameters import ErrorSizes
from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform
from sim.matching.geometry import geometry_fit
from sim.matching.geometry.board_shape import bend_displacements_mm, bend_mm
from sim.matching.match import moved_um
from sim.matching.reference import Reference
from sim.matching.steps import REPEATED_STEPS
from sim.parameters import TwinParameters
from tests.sim.matching.test_matching import PLAN, truth
from tests.support.plane_twin import CAMERA, PAIR, PROJECTOR, TARGET, PlaneTwin, Remembered, nominal
from tests.support.rigs import BOARD, SQUARE, observed, poses
from tests.support.rigs import CAMERA as RIG_CAMERA

__all__ = ["truth"]  # a fixture


def bent() -> np.ndarray[Any, np.dtype[np.float64]]:
    """The board's points on a shallow bowl with a twist."""
    board = TARGET.points()
    x, y = board[:, 0] / 30.0, board[:, 1] / 20.0
    board[:, 2] = 0.02 * x**2 - 0.01 * x * y + 0.004 * y**3
    return board


def test_bend_is_interpolated_and_goes_on_beyond_the_points() -> None:
    places = np.array([[3.0, -5.0], [-20.0, 11.0], [0.0, 0.0]])
    x, y = places.T / [[30.0], [20.0]]
    np.testing.assert_allclose(bend_mm(bent(), places), 0.02 * x**2 - 0.01 * x * y + 0.004 * y**3, atol=1e-9)
    most = bent()[:, :2].max(axis=0)
    beyond = bend_mm(bent(), np.array([most, 2 * most]))
    assert beyond[0] == pytest.approx(beyond[1])
    assert not bend_mm(TARGET.points(), places).any()


def height(x: Floats, y: Floats) -> Floats:
    """By how much the board of `bent` lies along its normal from its plane, within its points."""
    low, high = TARGET.points()[:, :2].min(axis=0), TARGET.points()[:, :2].max(axis=0)
    x, y = np.clip(x, low[0], high[0]) / 30.0, np.clip(y, low[1], high[1]) / 20.0
    return np.asarray(0.02 * x**2 - 0.01 * x * y + 0.004 * y**3)


def test_the_bend_moves_the_surface_along_its_normal(truth: TwinParameters) -> None:
    known = SimpleNamespace(board=bent())
    reference = Reference((), TARGET, cast(Any, known))
    moves = bend_displacements_mm(reference, truth, 0, (np.array([150, 160]), np.array([200, 240])))
    np.testing.assert_allclose(np.cross(moves, truth.poses[0].rotation[:, 2]), 0.0, atol=1e-12)
    assert np.abs(moves).max() > 1e-4


@pytest.mark.whole
def test_a_bent_board_is_not_taken_for_another_geometry(truth: TwinParameters) -> None:
    """Recordings of a board that is bent: the step stays near the truth only if the bend is known."""
    bench = PlaneTwin(truth, 1, height)
    sessions = tuple(Remembered.of(bench, PLAN, pose) for pose in range(len(truth.poses)))
    calibration = Calibration(CAMERA, PROJECTOR, PAIR, {})
    steps = []
    for board in (bent(), TARGET.points()):
        known = SimpleNamespace(poses=truth.poses, calibration=calibration, board=board)
        reference = Reference(cast(Any, sessions), TARGET, cast(Any, known))
        found = geometry_fit.refine_by_images(reference, PlaneTwin(truth), DistortionModel.TANGENTIAL)
        steps.append(moved_um(truth, found))
    with_bend, without = steps
    assert without > 5.0
    assert with_bend < 0.4 * without


def test_images_are_weighed_with_points_and_less_where_they_contradict_them() -> None:
    covariance = np.diag([1.0, 4.0, 1.0])
    covariance[0, 2] = covariance[2, 0] = 0.8  # with a pose, of which points say nothing
    known, of_points = np.array([2.0, 0.0]), np.diag([1.0, 4.0])
    step, left = geometry_fit.weigh_estimates(np.zeros(3), covariance, known, of_points, np.arange(2))
    np.testing.assert_allclose(step, [1.0, 0.0, 0.8])
    np.testing.assert_allclose(np.diag(left), [0.5, 2.0, 1.0 - 0.8**2 / 2])
    near = known + [100.0, 0.0]
    step, left = geometry_fit.weigh_estimates(np.zeros(3), 1e-4 * covariance, near, of_points, np.arange(2))
    assert abs(step[0] - near[0]) < 2.0  # in spite of the small covariance of the images
    assert 0.5 < left[0, 0] <= 1.0


def test_what_is_fixed_to_the_board_is_as_uncertain_in_many_poses_as_in_one() -> None:
    """Grain moves a focal length alike in all poses, so that their number does not average it."""
    random, poses = np.random.default_rng(5), 16
    grain, own = random.standard_normal((1, 25, 1)), random.standard_normal((poses, 25, 1))
    one, many, independent = (
        float(np.sqrt(geometry_fit.covariance_by_tiles(np.eye(1) / len(scores), scores)[0, 0]))
        for scores in (grain, np.repeat(grain, poses, axis=0), own)
    )
    assert many == pytest.approx(one, rel=0.3)
    assert independent == pytest.approx(np.sqrt(2 / poses) * np.sqrt(25), rel=0.3)


@pytest.mark.parametrize("drift_px", [0.0, 0.05])
def test_the_geometry_is_that_of_the_points_where_the_projector_drifts(drift_px: float) -> None:
    sizes = ErrorSizes(0.02, 0.02, 0.01, 0.01, drift_px=drift_px)
    at = SimpleNamespace(reference=Reference((), TARGET, cast(Any, SimpleNamespace(sizes=sizes))))
    (images,) = (step for step in REPEATED_STEPS if step.name == "images")
    assert images.applies(cast(Any, at)) is (drift_px == 0)


@pytest.mark.whole
def test_points_keep_the_drift_that_the_characterisation_found() -> None:
    truth, walk = poses(5), np.cumsum(np.tile([0.12, -0.08], (5, 1)), axis=0)
    seen = [
        replace(o, projector_px=o.projector_px + by)
        for o, by in zip(observed(truth, noise_px=0.01), walk, strict=True)
    ]
    found = characterise(seen, BOARD, RIG_CAMERA.size, SQUARE.size, validate=False)
    assert found.sizes is not None
    assert found.sizes.drift_px > 0
    start = replace(nominal(found.poses), calibration=found.calibration)
    refined = geometry_fit.refine_by_reprojection(start, found)
    assert moved_um(start, refined) < 5.0


def test_a_change_of_a_rotation_vector_is_a_turn_about_the_axes() -> None:
    vector, change = np.array([0.3, -0.2, 0.5]), 1e-6 * np.array([1.0, 2.0, -3.0])
    before, after = (RigidTransform.from_vectors(v, np.zeros(3)).rotation for v in (vector, vector + change))
    turn = RigidTransform(after @ before.T, np.zeros(3)).rotation_vector
    np.testing.assert_allclose(geometry_fit.left_jacobian(vector) @ change, turn, rtol=1e-4)
    np.testing.assert_allclose(geometry_fit.left_jacobian(np.zeros(3)), np.eye(3))
