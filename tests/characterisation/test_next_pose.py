"""The choice of the next pose, against covariances that the bundle adjustment computes itself."""

from dataclasses import replace

import numpy as np
import pytest

from fpplab.calibration.model import Calibration
from fpplab.characterisation import Observation
from fpplab.characterisation.bundle import estimate_uncertainty
from fpplab.characterisation.candidate_poses import (
    DIRECTIONS,
    MAX_SLANT_DEG,
    _paths_from_field_centre,
    board_grid,
    candidate_poses,
    tilted_away,
    visible_shares,
)
from fpplab.characterisation.estimate import JointEstimate, first_estimate
from fpplab.characterisation.next_pose import Design, best_pose, expected_observation
from fpplab.characterisation.parameters import vectors_of
from fpplab.characterisation.pose_effects import smooth_functions
from fpplab.characterisation.working_volume import WorkingVolume
from fpplab.core import config
from fpplab.core.conventions import Floats, Lattice
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import RigidTransform
from fpplab.targets import Target
from tests.support.plane_twin import CAMERA, PAIR, PROJECTOR, TARGET, tilted

SIZES, DEPTH = (CAMERA.size, PROJECTOR.size), (425.0, 475.0)
BENT = TARGET.points() + np.random.default_rng(9).normal(0, 0.005, (52, 3))


def seen(
    pose: RigidTransform, random: np.random.Generator, board: Floats = BENT, name: str = ""
) -> Observation:
    """A pose with noise, and with errors that its points share."""
    places = pose.apply(board)
    ids = np.flatnonzero(CAMERA.sees(places) & PROJECTOR.sees(places, PAIR))
    functions = smooth_functions(board[ids, :2])
    pixels = [
        exact + random.normal(0, 0.03, exact.shape) + functions @ random.normal(0, 0.01, (6, 2))
        for exact in (CAMERA.project(places[ids]), PROJECTOR.project(places[ids], PAIR))
    ]
    return Observation(name, ids, pixels[0], pixels[1])


@pytest.fixture(scope="module")
def estimate() -> JointEstimate:
    """Of five poses over the field, so that errors are small enough for derivatives to tell them."""
    random = np.random.default_rng(1)
    field = candidate_poses(Calibration(CAMERA, PROJECTOR, PAIR, {}), TARGET.size_mm, DEPTH)
    poses = [seen(pose, random, name=f"pose_{k}") for k, pose in enumerate(field[7::43])]
    return first_estimate(poses, TARGET, SIZES, Lattice.SQUARE)[0]


@pytest.fixture(scope="module")
def volume(estimate: JointEstimate) -> WorkingVolume:
    return WorkingVolume.of(estimate.calibration, DEPTH)


@pytest.fixture(scope="module")
def candidates(estimate: JointEstimate) -> list[RigidTransform]:
    return candidate_poses(estimate.calibration, TARGET.size_mm, DEPTH)


def test_paths_of_candidates_end_at_the_edges_of_the_image() -> None:
    paths = _paths_from_field_centre(Calibration(CAMERA, PROJECTOR, PAIR, {}), 450.0)
    ends = CAMERA.project(paths[:, -1])
    middle, (width, height) = ends[0], CAMERA.size
    for end, (x, y) in zip(ends[1:], DIRECTIONS, strict=True):
        edges = [[0.0, middle[0], width - 1.0][x + 1], [0.0, middle[1], height - 1.0][y + 1]]
        np.testing.assert_allclose(end, edges, atol=1e-3)


def with_expected(estimate: JointEstimate, pose: RigidTransform) -> tuple[float, Floats]:
    """Form by the covariance of the bundle adjustment with the pose's expected observation."""
    best = estimate.solution
    more = replace(best, poses=np.vstack([best.poses, vectors_of(pose)]))
    observations = (*estimate.observations, expected_observation(estimate, pose))
    exact = replace(estimate.model, scale_tolerance=0.0)
    found = estimate_uncertainty(observations, more, exact, estimate.sizes).covariance
    return WorkingVolume.of(estimate.calibration, DEPTH).form_mm(best, exact.level, found), found


def test_the_prediction_is_the_covariance_with_the_pose(
    estimate: JointEstimate, volume: WorkingVolume, candidates: list[RigidTransform]
) -> None:
    """Two ways to one number: Schur complements here, the whole normal equations there."""
    design = Design.of(estimate, volume)
    now = volume.form_mm(estimate.solution, estimate.model.level, estimate.covariance)
    assert design.predicted_mm()[1] == pytest.approx(now, rel=1e-6)
    for pose in candidates[::60]:
        expected, _ = with_expected(estimate, pose)
        assert design.predicted_mm(pose)[1] == pytest.approx(expected, rel=1e-5)
        assert design.predicted_mm(pose)[0] < design.predicted_mm()[0]


@pytest.mark.nightly
def test_what_is_chosen_is_the_best_when_the_pose_is_really_taken(
    estimate: JointEstimate, volume: WorkingVolume, candidates: list[RigidTransform]
) -> None:
    """With fresh noise and a whole adjustment, at its own solution."""
    design, random = Design.of(estimate, volume), np.random.default_rng(2)
    some = [*candidates[::30], candidates[best_pose(design, candidates)[0]]]
    found = []
    for pose in some:
        taken = estimate.with_pose(seen(pose, random, name="next"))
        covariance = replace(taken, sizes=estimate.sizes).covariance
        slopes = volume.slopes(taken.solution, taken.model.level)
        found.append([np.sqrt(np.einsum("mi,ij,mj->", one, covariance, one)) for one in slopes])
    predicted, real = np.array([design.predicted_mm(pose) for pose in some]), np.array(found)
    np.testing.assert_allclose(real / predicted, 1.0, atol=0.15)
    products = real.prod(axis=1)
    assert products[-1] <= 1.3 * products.min()  # each is within 15 % of what is predicted, twice
    assert products[-1] < 0.9 * np.median(products)


def test_candidates_are_seen_and_lit(estimate: JointEstimate, candidates: list[RigidTransform]) -> None:
    known = estimate.calibration
    assert len(candidates) > 100
    for pose in candidates:
        assert visible_shares(known, pose.apply(board_grid(TARGET.size_mm))) == 1.0
        away = pose.translation - known.projector_centre
        slant = np.degrees(np.arccos(away @ pose.rotation[:, 2] / np.linalg.norm(away)))
        assert slant < MAX_SLANT_DEG + 2.0
    places = np.array([pose.translation for pose in candidates])
    assert np.ptp(places[:, 2]) == pytest.approx(50.0)
    assert np.ptp(places[:, 0]) > 60.0


@pytest.mark.nightly
def test_boards_of_many_points_are_thinned_without_another_answer(volume: WorkingVolume) -> None:
    fields = {**config.plain(TARGET), "counts": [26, 8], "spacing_mm": [2.2, 4.4], "diameter_mm": 1.2}
    many = config.validate(fields, Target, "board")
    random = np.random.default_rng(4)
    poses = [seen(pose, random, many.points(), f"pose_{k}") for k, pose in enumerate(tilted(5, 1))]
    found, _ = first_estimate(poses, many, SIZES, Lattice.SQUARE)
    design = Design.of(found, volume)
    assert len(design.estimate.solution.board) <= 80 < len(many.points())
    whole = volume.form_mm(found.solution, found.model.level, found.covariance)
    assert design.predicted_mm()[1] == pytest.approx(whole, rel=0.25)


def test_a_board_larger_than_the_field_is_refused(estimate: JointEstimate) -> None:
    with pytest.raises(CalibrationError, match="board of 900 x 600 mm is not seen"):
        candidate_poses(estimate.calibration, (900.0, 600.0), DEPTH)


def test_the_edge_that_is_named_goes_away() -> None:
    upper, right = np.array([0.0, -20.0, 0.0]), np.array([30.0, 0.0, 0.0])
    assert (tilted_away((0, -1), 25.0) @ upper)[2] == pytest.approx(20.0 * np.sin(np.radians(25.0)))
    assert (tilted_away((1, 0), 25.0) @ right)[2] > 0
    assert (tilted_away((1, 0), 25.0) @ upper)[2] == pytest.approx(0.0)
