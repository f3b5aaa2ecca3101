"""Judging a calibration by poses that it was not fitted to, and putting its uncertainty to the test."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fpplab.calibration.model import Calibration, Uncertainty
from fpplab.characterisation import Characterisation, DistortionModel, Observation, characterise, judge
from fpplab.characterisation.pose_effects import smooth_functions
from fpplab.characterisation.validation import beyond_chance, compare_with_fewer_poses, projected_uncertainty
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import RigidTransform
from tests.support.rigs import BOARD, CAMERA, PAIR, SQUARE, observed, poses

NOISE_PX = 0.04
BENT = BOARD.points() + np.random.default_rng(5).normal(0, 0.015, (52, 3))


def seen(count: int, seed: int) -> list[Observation]:
    return observed(poses(count, seed=seed), noise_px=NOISE_PX, points=BENT, seed=seed)


@cache
def of_nine_poses() -> Characterisation:
    return characterise(seen(9, 1), BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.K3)


@pytest.fixture
def found() -> Characterisation:
    return of_nine_poses()


def test_errors_in_other_poses_are_those_predicted(found: Characterisation) -> None:
    """Over 10 x 52 points of fresh noise the RMS scatters by 2 %, the devices' uncertainty adds some."""
    told = judge(found.calibration, seen(10, 2))
    assert not told.contradicted
    assert told.verdict.startswith("the calibration holds")
    for errors in (told.camera, told.projector):
        assert errors.rms_px == pytest.approx(errors.predicted_px, rel=0.12)
        assert errors.predicted_px > NOISE_PX * np.sqrt(2)
    assert [p.name for p in told.poses] == [f"pose_{k}" for k in range(10)]
    assert told.summary()["poses"][3]["points"] == 52


def test_few_poses_predict_greater_errors(found: Characterisation) -> None:
    few = characterise(seen(4, 1), BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.K3)
    by_few, by_more = (judge(c.calibration, seen(6, 3)) for c in (few, found))
    assert by_few.camera.predicted_px > 1.05 * by_more.camera.predicted_px
    assert not by_few.contradicted


@pytest.mark.whole
def test_the_board_s_scale_does_not_count(found: Characterisation) -> None:
    """A board of unknown scale changes all lengths, and no image."""
    loose = BOARD.model_copy(update={"scale_tolerance": 0.05})
    wide = characterise(seen(9, 1), loose, CAMERA.size, SQUARE.size, level=DistortionModel.K3)
    tight, told = (judge(c.calibration, seen(3, 4)) for c in (found, wide))
    assert told.projector.predicted_px == pytest.approx(tight.projector.predicted_px, rel=1e-3)


def test_a_projector_that_was_turned_since_is_noticed(found: Characterisation) -> None:
    turned = RigidTransform.from_vectors(np.radians([0.0, 0.0, 0.05]), np.zeros(3)) @ PAIR
    moved = [
        replace(o, projector_px=o.projector_px + SQUARE.project(at, turned) - SQUARE.project(at, PAIR))
        for o, at in ((o, t.apply(BENT)) for o, t in zip(seen(6, 5), poses(6, seed=5), strict=True))
    ]
    told = judge(found.calibration, moved)
    assert told.contradicted
    assert "contradict the calibration" in told.verdict
    assert "characterise again" in told.verdict


def test_a_pose_in_which_the_board_moved_is_named(found: Characterisation) -> None:
    others = seen(8, 6)
    others[2] = replace(others[2], projector_px=others[2].projector_px + 0.25 * np.arange(52)[:, None] / 52)
    told = judge(found.calibration, others)
    assert [p.name for p in told.poses if p.contradicts] == ["pose_2"]


def test_a_calibration_file_keeps_all_that_is_needed(found: Characterisation, tmp_path: Path) -> None:
    found.calibration.save(tmp_path / "c.yaml")
    first, again = (judge(c, seen(3, 7)) for c in (found.calibration, Calibration.load(tmp_path / "c.yaml")))
    assert again.camera.rms_px == pytest.approx(first.camera.rms_px, abs=1e-4)
    assert again.projector.predicted_px == pytest.approx(first.projector.predicted_px, rel=1e-4)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"board": None}, r"c\.yaml: 'board' is missing.*characterise again"),
        ({"uncertainty": None}, r"c\.yaml: 'uncertainty' is missing"),
        ({"uncertainty": Uncertainty(("camera.fx",), np.eye(1))}, r"'uncertainty\.names' are not those"),
    ],
)
def test_what_a_calibration_does_not_say_is_named(
    found: Characterisation, change: dict[str, object], words: str
) -> None:
    with pytest.raises(CalibrationError, match=words):
        judge(replace(found.calibration, **change), seen(2, 8), source="c.yaml")  # type: ignore[arg-type]


@pytest.mark.whole
@pytest.mark.parametrize("poses_known", [4, 12])
def test_few_poses_say_little_of_what_the_next_pose_shares(found: Characterisation, poses_known: int) -> None:
    """Drawn errors of which the stated size is as uncertain as from so many poses."""
    random, true_px, chances = np.random.default_rng(poses_known), 0.1, list[float]()
    known, smooth = found.calibration, smooth_functions(BOARD.points()[:, :2])
    assert known.board is not None
    board = replace(known.board, points=BENT)
    for seed in range(60):
        shared_px = true_px * float(np.sqrt(random.chisquare(poses_known - 1) / (poses_known - 1)))
        errors = {"camera_px": NOISE_PX, "projector_px": NOISE_PX, "carried": 0.0, "poses": poses_known}
        errors |= {"camera_shared_px": shared_px, "projector_shared_px": shared_px}
        stated = replace(board, errors=board.errors.model_copy(update=errors))
        truth = replace(known, camera=CAMERA, projector=SQUARE, T_projector_camera=PAIR, board=stated)
        pose = seen(1, 100 + seed)[0]
        off = smooth @ random.normal(0, true_px, (2, 6, 2))
        pose = replace(pose, camera_px=pose.camera_px + off[0], projector_px=pose.projector_px + off[1])
        told = judge(replace(truth, uncertainty=exact(known.uncertainty)), [pose])
        chances += [told.camera.chance, told.projector.chance]
    assert 0.01 <= np.mean(np.array(chances) < 0.05) <= 0.10


def exact(uncertainty: Uncertainty | None) -> Uncertainty:
    assert uncertainty is not None
    return replace(uncertainty, covariance=1e-8 * uncertainty.covariance)


def test_without_a_pose_there_is_no_judgement(found: Characterisation) -> None:
    with pytest.raises(CalibrationError, match=r"no pose to judge by .*too dark"):
        judge(found.calibration, [], {"pose_1": "pose_1: too dark"})


# Fewer poses


def test_calibrations_from_fewer_poses_change_as_predicted(found: Characterisation) -> None:
    """With nine poses a jackknife scatters by some 25 % and more, the difference of halves freely."""
    assert found.validation is not None
    assert not found.validation.warnings
    names = ["camera.fx", "projector.fx", "baseline", "place", "form"]
    assert [one.quantity for one in found.validation.jackknife] == names
    assert [one.quantity for one in found.validation.halves] == names
    assert all(0.3 < one.ratio < 2.0 for one in found.validation.jackknife)
    assert all(one.ratio < 4.0 for one in found.validation.halves)
    assert 0.5 < np.mean([one.ratio for one in found.validation.jackknife]) < 1.5
    sigma = found.calibration.uncertainty
    assert sigma
    assert found.validation.jackknife[0].stated == pytest.approx(sigma.sigma["camera.fx"], rel=1e-6)


def test_an_uncertainty_that_is_too_small_is_named(found: Characterisation) -> None:
    """The focal length changes by 0.2 % when a pose is left out, three standard uncertainties and more."""
    assert found.solution
    assert found.sizes
    assert found.model
    solution, sizes = found.solution, found.sizes
    without = [
        replace(
            solution, camera=solution.camera * (1 + 2e-3 * (-1) ** k), poses=np.delete(solution.poses, k, 0)
        )
        for k in range(9)
    ]
    told = compare_with_fewer_poses(found.observations, solution, found.model, sizes, without)
    assert "leaving poses out changes the camera's focal length" in " ".join(told.warnings)


def test_only_what_is_beyond_chance_widens_a_covariance() -> None:
    """11 degrees of freedom for 24 parameters, with and without a direction of ten times the size."""
    random, size = np.random.default_rng(3), 24
    root = random.normal(size=(size, size)) * np.logspace(0, 3, size)[:, None]
    covariance, odd = root @ root.T, root @ np.eye(size)[0]
    added = {0.0: [], 10.0: []}
    for sigma, found in added.items():
        for _ in range(20):
            seen = random.normal(size=(11, size)) @ root.T + sigma * random.normal(size=(11, 1)) * odd
            found.append(beyond_chance(covariance, seen.T @ seen / 11, 11, covariance))
    assert np.mean([np.trace(np.linalg.solve(covariance, one)) for one in added[0.0]]) < 1.0
    along = np.linalg.solve(root, np.mean(added[10.0], axis=0)) @ np.linalg.inv(root).T
    assert 0.6 * sigma**2 < along[0, 0] < 1.3 * sigma**2
    assert np.abs(along[1:, 1:]).max() < 0.1 * along[0, 0]
    expected = covariance + sigma**2 * np.outer(odd, odd)  # as of a pose that alone determines a direction
    assert np.abs(beyond_chance(covariance, seen.T @ seen / 11, 11, expected)).max() == 0.0


def test_the_projected_uncertainty_of_a_focal_length_grows_from_the_centre() -> None:
    """du = (u - cx) dfx/fx, and half of its square is the mean of u and v; no turn explains any of it."""
    flat = replace(CAMERA, distortion=np.zeros(5))
    calibration = Calibration(flat, SQUARE, PAIR, {}, Uncertainty(("camera.fx",), np.array([[4.0]])))
    cx, fx = flat.matrix[0, 2], flat.matrix[0, 0]
    offsets = np.array([-400.0, -200.0, 0.0, 200.0, 400.0])
    pixels = np.stack([cx + offsets, np.full(5, flat.matrix[1, 2])], axis=1)
    sigma = projected_uncertainty(calibration, "camera", pixels, 300.0)
    assert sigma == pytest.approx(np.abs(offsets) / fx * 2.0 / np.sqrt(2), abs=1e-6)
    with pytest.raises(CalibrationError, match="how uncertain"):
        projected_uncertainty(replace(calibration, uncertainty=None), "camera", pixels, 300.0)
