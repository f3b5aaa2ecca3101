"""Characterisation: what is put in comes out."""

from dataclasses import replace

import numpy as np
import pytest

from fpplab.calibration.model import Calibration
from fpplab.characterisation import DistortionModel, Observation, characterise
from fpplab.characterisation.bundle import adjust_bundle, covariance_with_poses, estimate_uncertainty
from fpplab.characterisation.parameters import ErrorSizes, Model, vectors_of
from fpplab.characterisation.problem import Problem
from fpplab.core.geometry import Pinhole
from tests.support.rigs import BOARD, CAMERA, DIAMOND, PAIR, SQUARE, observed, poses, truth_of, values


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("projector", [SQUARE, DIAMOND], ids=["square", "diamond"])
def test_parameters_are_recovered_within_their_uncertainty(projector: Pinhole) -> None:
    noise = 0.05
    found = characterise(
        observed(poses(8), projector, noise), BOARD, CAMERA.size, projector.size, projector.lattice,
        level=DistortionModel.TANGENTIAL,
    )  # fmt: skip
    expected = values(Calibration(CAMERA, projector, PAIR, {}))
    pulls = {k: (v - expected[k]) / found.sigma[k] for k, v in values(found.calibration).items()}
    assert max(abs(p) for p in pulls.values()) < 3.5, pulls
    assert 0.4 < np.sqrt(np.mean(np.square(list(pulls.values())))) < 1.8
    for figure in found.calibration.rms_px.values():
        assert figure == pytest.approx(noise * np.sqrt(2), rel=0.1)
    assert found.calibration.projector.lattice is projector.lattice
    assert found.calibration.projector.size == projector.size


def test_without_noise_parameters_and_poses_are_exact() -> None:
    truth = poses(5)
    found = characterise(observed(truth), BOARD, CAMERA.size, SQUARE.size, validate=False)
    expected = values(Calibration(CAMERA, SQUARE, PAIR, {}))
    for name, value in values(found.calibration).items():
        assert value == pytest.approx(expected[name], rel=2e-5, abs=2e-5), name
    for pose_found, pose_true in zip(found.poses, truth, strict=True):
        np.testing.assert_allclose(pose_found.matrix, pose_true.matrix, atol=2e-3)


@pytest.mark.whole
@pytest.mark.parametrize("centre", [(905, 1300), (2000, 570)])
def test_a_lens_shifted_beyond_the_edge_is_found(centre: tuple[int, int]) -> None:
    shifted = Pinhole.from_focal((1824, 1140), (2600, 2600), centre)
    found = characterise(observed(poses(8), shifted, 0.03), BOARD, CAMERA.size, shifted.size, validate=False)
    for row, name in enumerate(("cx", "cy")):
        doubt = 4 * found.sigma[f"projector.{name}"]
        assert found.calibration.projector.matrix[row, 2] == pytest.approx(centre[row], abs=doubt)
    assert found.calibration.rms_px["projector"] < 0.05


@pytest.mark.whole
def test_the_error_in_unseen_poses_is_a_little_more_than_the_noise() -> None:
    seen = observed(poses(8), noise_px=0.1)
    found = characterise(seen, BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.K3)
    assert found.leave_one_out_px is not None
    for device in ("camera", "projector"):
        held_out, fitted = found.leave_one_out_px[device], found.calibration.rms_px[device]
        assert fitted < held_out < 1.4 * fitted


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("seed", range(2))
def test_poses_are_as_uncertain_as_their_covariance_says(seed: int) -> None:
    truth = poses(8)
    found = characterise(
        observed(truth, noise_px=0.05, seed=seed), BOARD, CAMERA.size, SQUARE.size,
        level=DistortionModel.TANGENTIAL, validate=False,
    )  # fmt: skip
    assert found.solution is not None
    assert found.model is not None
    assert found.sizes is not None
    joint = covariance_with_poses(found.observations, found.solution, found.model, found.sizes)
    off = found.solution.poses - np.array([vectors_of(pose) for pose in truth])
    error, of_poses = off.ravel(), joint[-off.size :, -off.size :]
    assert 0.6 < error @ np.linalg.solve(of_poses, error) / off.size < 1.6
    own = error / np.sqrt(np.diag(of_poses))
    assert 0.3 < np.sqrt(np.mean(own**2)) < 1.8


def test_without_validation_the_geometry_is_the_same() -> None:
    seen = observed(poses(4), noise_px=0.02)
    checked, quick = (
        characterise(seen, BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.K3, validate=validate)
        for validate in (True, False)
    )
    assert values(quick.calibration) == values(checked.calibration)
    assert quick.calibration.rms_px == checked.calibration.rms_px
    assert quick.leave_one_out_px is None
    assert checked.leave_one_out_px is not None


def test_three_poses_give_a_result_but_no_error_in_unseen_poses() -> None:
    found = characterise(observed(poses(3), noise_px=0.02), BOARD, CAMERA.size, SQUARE.size)
    assert found.leave_one_out_px is None
    assert found.summary()["leave_one_out"] == {"camera_px": None, "projector_px": None}
    assert found.calibration.rms_px["joint"] < 0.04


@pytest.mark.whole
def test_a_few_gross_errors_do_not_spoil_the_result() -> None:
    clean = observed(poses(8), noise_px=0.05)
    spoiled = [replace(o, camera_px=o.camera_px.copy()) for o in clean]
    for k in range(8):
        spoiled[k].camera_px[6 * k] += (3.0, -2.0)
    without, found = (
        characterise(seen, BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.TANGENTIAL, validate=False)
        for seen in (clean, spoiled)
    )
    expected = values(without.calibration)
    for name, value in values(found.calibration).items():
        assert value == pytest.approx(expected[name], abs=1.2 * without.sigma[name]), name


@pytest.mark.whole
def test_partial_views_are_used() -> None:
    whole = observed(poses(8), noise_px=0.03)
    random = np.random.default_rng(3)
    part = []
    for o in whole:
        kept = np.sort(random.choice(len(o.ids), 30, replace=False))
        part.append(Observation(o.name, o.ids[kept], o.camera_px[kept], o.projector_px[kept]))
    found = characterise(part, BOARD, CAMERA.size, SQUARE.size, validate=False)
    assert found.points == 240
    assert found.calibration.rms_px["joint"] == pytest.approx(0.03 * np.sqrt(2), rel=0.1)


@pytest.mark.whole
def test_a_board_within_its_tolerance_has_its_shape_found() -> None:
    drawn = BOARD.points()
    bend = 0.1 * (drawn[:, 0] / 30) ** 2 - 0.05
    bent = drawn + np.stack([np.zeros(52), np.zeros(52), bend], axis=1)
    seen = observed(poses(10), noise_px=0.03, points=bent)
    flat, fitted = (
        characterise(seen, BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.K3, refine_board=refined)
        for refined in (False, None)
    )
    assert flat.calibration.rms_px["joint"] > 2 * 0.03 * np.sqrt(2)
    assert fitted.calibration.rms_px["joint"] == pytest.approx(0.03 * np.sqrt(2), rel=0.12)
    heights = fitted.board[:, 2]
    assert np.corrcoef(heights, bend)[0, 1] > 0.99
    assert fitted.leave_one_out_px["camera"] < 0.5 * flat.leave_one_out_px["camera"]  # type: ignore[index]


@pytest.mark.parametrize("level", list(DistortionModel))
@pytest.mark.parametrize("refined", [False, True])
def test_normal_equations_are_those_of_the_misfit(level: DistortionModel, refined: bool) -> None:
    seen = observed(poses(3), noise_px=0.5)
    seen[1] = replace(
        seen[1],
        ids=seen[1].ids[5:20],
        camera_px=seen[1].camera_px[5:20],
        projector_px=seen[1].projector_px[5:20],
    )
    start = truth_of(poses(3))
    start.camera[9:], start.projector[9:] = (0.3, -0.2, 0.1), (-0.1, 0.2, 0.4)
    start = replace(start, carried=0.3)
    sizes = ErrorSizes(0.3, 0.2, 0.1, 0.05)
    problem = Problem(tuple(seen), Model(level, BOARD.points() + 0.02, refined), sizes, start)
    vector = problem.pack(start)
    slopes = np.empty((len(problem.misfit(vector)), len(vector)))
    for column in range(len(vector)):
        step = np.zeros_like(vector)
        step[column] = 1e-6 * max(abs(vector[column]), 1.0)
        change = problem.misfit(vector + step) - problem.misfit(vector - step)
        slopes[:, column] = change / (2 * step[column])
    residuals = problem.misfit(vector)
    for limit in (np.inf, 0.5):
        weight = (
            np.minimum(1.0, limit / np.maximum(np.abs(residuals), 1e-12))
            if np.isfinite(limit)
            else np.ones_like(residuals)
        )
        normal, gradient = problem.normal_equations(vector, limit)
        scale = np.sqrt(np.diag(normal))
        expected = slopes.T @ (weight[:, None] * slopes)
        np.testing.assert_allclose(
            normal / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-5
        )
        size = np.linalg.norm(np.sqrt(weight) * residuals)
        np.testing.assert_allclose(
            gradient / scale, slopes.T @ (weight * residuals) / scale, atol=1e-5 * size
        )


@pytest.mark.whole
@pytest.mark.parametrize("tolerance", [None, pytest.param(0.05, marks=pytest.mark.nightly)])
def test_the_truth_lies_within_its_uncertainty_in_repeats(tolerance: float | None) -> None:
    """40 repeats with fresh noise and, where it is free, a freshly bent board."""
    held, start, pulls, distances = poses(6), truth_of(poses(6)), [], []
    expected = values(Calibration(CAMERA, SQUARE, PAIR, {}))
    model = Model(DistortionModel.TANGENTIAL, BOARD.points(), tolerance is not None)
    for seed in range(40):
        bend = np.random.default_rng([7, seed]).normal(0, tolerance or 0, (52, 3))
        seen = observed(held, noise_px=0.05, points=BOARD.points() + bend, seed=seed)
        solution, sizes = adjust_bundle(seen, start, model)
        known = estimate_uncertainty(seen, solution, model, sizes)
        found = np.concatenate([solution.camera[:8], solution.projector[:8], solution.T_projector_camera])
        error = found - [expected[name] for name in known.names]
        pair = known.covariance[-3:, -3:]
        along = PAIR.translation / np.linalg.norm(PAIR.translation)
        baseline = np.linalg.norm(solution.T_projector_camera[3:]) - np.linalg.norm(PAIR.translation)
        wanted = [f"{d}.{t}" for d in ("camera", "projector") for t in ("fx", "fy", "cx", "cy")]
        pulls += [(found[known.names.index(n)] - expected[n]) / known.sigma[n] for n in wanted]
        pulls.append(baseline / np.sqrt(along @ pair @ along))
        distances.append(error @ np.linalg.solve(known.covariance, error))
    assert np.mean(np.abs(pulls) < 3) >= 0.95
    # Six poses do not rule out errors that poses share, which widens the uncertainty by up to a third.
    assert 0.75 < np.sqrt(np.mean(np.square(pulls))) < 1.15
    # Of chi squared with 22 degrees of freedom the mean of 40 has a standard deviation of 1.05.
    assert 22 - 4.2 < np.mean(distances) < 22 + 4.2
