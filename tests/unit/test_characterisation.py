"""Characterisation: what is put in comes out, and what does not belong is thrown out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from fpplab import config
from fpplab.calibration import Calibration
from fpplab.characterisation import Observation, characterise, finest_periods, observe
from fpplab.characterisation.bundle import Problem, Solution, vectors_of
from fpplab.conventions import Lattice
from fpplab.errors import CalibrationError
from fpplab.geometry import Pinhole, RigidTransform
from fpplab.phase import decode
from fpplab.plan import Plan
from fpplab.targets import Target
from tests.unit.boards import plane_homography, pose, render

DATA = Path(os.environ.get("FPPLAB_DATA", Path(__file__).parents[2].parent / "shared" / "data")) / "slstudio"

BOARD = config.validate(
    {"kind": "circles", "size_mm": [60, 42], "counts": [13, 4], "spacing_mm": [4.5, 9],
     "staggered": True, "diameter_mm": 3, "foreground": 0.9, "background": 0.3},
    Target, "board.yaml",
)  # fmt: skip

CAMERA = Pinhole.from_focal((1200, 900), (2200, 2195), (610, 440), (-0.09, 0.12, 5e-4, -3e-4, 0))
SQUARE = Pinhole.from_focal((1824, 1140), (2600, 2605), (860, 1125), (-0.05, 0.02, 2e-4, 1e-4, 0))
DIAMOND = Pinhole.from_focal((912, 1140), (1300, 2600), (450, 1135), (-0.05, 0.02, 0, 0, 0), Lattice.DIAMOND)
PAIR = RigidTransform.from_vectors(np.radians([4.0, 18.0, 1.0]), np.array([-80.0, 60.0, 15.0]))


def poses(count: int, seed: int = 0) -> list[RigidTransform]:
    random = np.random.default_rng(seed)
    tilts = random.uniform(-35, 35, (count, 3))
    places = random.uniform((-30, -20, 220), (30, 20, 280), (count, 3))
    return [pose(tuple(t), tuple(p)) for t, p in zip(tilts, places, strict=True)]  # type: ignore[arg-type]


def observed(
    T_camera_board: Sequence[RigidTransform],
    projector: Pinhole = SQUARE,
    noise_px: float = 0.0,
    points: np.ndarray | None = None,
    seed: int = 1,
) -> list[Observation]:
    """What perfect detection would give, with Gaussian noise on every coordinate."""
    random = np.random.default_rng(seed)
    board = BOARD.points() if points is None else points
    found = []
    for k, transform in enumerate(T_camera_board):
        seen = transform.apply(board)
        camera, light = CAMERA.project(seen), projector.project(seen, PAIR)
        noise = random.normal(0, noise_px, (2, *camera.shape)) if noise_px else np.zeros((2, 1, 1))
        found.append(Observation(f"pose_{k}", np.arange(len(board)), camera + noise[0], light + noise[1]))
    return found


NAMES = {
    "device": ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"],
    "pair": ["rx", "ry", "rz", "x", "y", "z"],
}


def values(calibration: Calibration) -> dict[str, float]:
    named = {}
    for name, device in (("camera", calibration.camera), ("projector", calibration.projector)):
        k = device.matrix
        terms = [k[0, 0], k[1, 1], k[0, 2], k[1, 2], *device.distortion[:4]]
        named |= {f"{name}.{t}": v for t, v in zip(NAMES["device"], terms, strict=True)}
    transform = vectors_of(calibration.T_projector_camera)
    return named | {f"T_projector_camera.{t}": v for t, v in zip(NAMES["pair"], transform, strict=True)}


# From points to parameters


@pytest.mark.parametrize("projector", [SQUARE, DIAMOND], ids=["square", "diamond"])
def test_parameters_are_recovered_within_their_uncertainty(projector: Pinhole) -> None:
    noise = 0.05
    found = characterise(
        observed(poses(8), projector, noise), BOARD, CAMERA.size, projector.size, projector.lattice
    )
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
    found = characterise(observed(truth), BOARD, CAMERA.size, SQUARE.size)
    expected = values(Calibration(CAMERA, SQUARE, PAIR, {}))
    for name, value in values(found.calibration).items():
        assert value == pytest.approx(expected[name], rel=2e-5, abs=2e-5), name
    for pose_found, pose_true in zip(found.poses, truth, strict=True):
        np.testing.assert_allclose(pose_found.matrix, pose_true.matrix, atol=2e-3)


@pytest.mark.parametrize("centre", [(905, 1300), (2000, 570)])
def test_a_lens_shifted_beyond_the_edge_is_found(centre: tuple[int, int]) -> None:
    shifted = Pinhole.from_focal((1824, 1140), (2600, 2600), centre)
    found = characterise(observed(poses(8), shifted, 0.03), BOARD, CAMERA.size, shifted.size)
    for row, name in enumerate(("cx", "cy")):
        doubt = 4 * found.sigma[f"projector.{name}"]
        assert found.calibration.projector.matrix[row, 2] == pytest.approx(centre[row], abs=doubt)
    assert found.calibration.rms_px["projector"] < 0.05


def test_the_error_in_unseen_poses_is_a_little_more_than_the_noise() -> None:
    found = characterise(observed(poses(8), noise_px=0.1), BOARD, CAMERA.size, SQUARE.size)
    assert found.leave_one_out_px is not None
    for device in ("camera", "projector"):
        held_out, fitted = found.leave_one_out_px[device], found.calibration.rms_px[device]
        assert fitted < held_out < 1.4 * fitted


def test_three_poses_give_a_result_but_no_error_in_unseen_poses() -> None:
    found = characterise(observed(poses(3), noise_px=0.02), BOARD, CAMERA.size, SQUARE.size)
    assert found.leave_one_out_px is None
    assert found.summary()["leave_one_out"] == {"camera_px": None, "projector_px": None}
    assert found.calibration.rms_px["joint"] < 0.04


def test_a_few_gross_errors_do_not_spoil_the_result() -> None:
    clean = observed(poses(8), noise_px=0.05)
    spoiled = [replace(o, camera_px=o.camera_px.copy()) for o in clean]
    for k in range(8):
        spoiled[k].camera_px[6 * k] += (3.0, -2.0)
    without = characterise(clean, BOARD, CAMERA.size, SQUARE.size)
    found = characterise(spoiled, BOARD, CAMERA.size, SQUARE.size)
    expected = values(without.calibration)
    for name, value in values(found.calibration).items():
        assert value == pytest.approx(expected[name], abs=1.2 * without.sigma[name]), name


def test_partial_views_are_used() -> None:
    whole = observed(poses(8), noise_px=0.03)
    random = np.random.default_rng(3)
    part = []
    for o in whole:
        kept = np.sort(random.choice(len(o.ids), 30, replace=False))
        part.append(Observation(o.name, o.ids[kept], o.camera_px[kept], o.projector_px[kept]))
    found = characterise(part, BOARD, CAMERA.size, SQUARE.size)
    assert found.points == 240
    assert found.calibration.rms_px["joint"] == pytest.approx(0.03 * np.sqrt(2), rel=0.1)


def test_a_board_within_its_tolerance_has_its_shape_found() -> None:
    drawn = BOARD.points()
    bend = 0.1 * (drawn[:, 0] / 30) ** 2 - 0.05
    bent = drawn + np.stack([np.zeros(52), np.zeros(52), bend], axis=1)
    seen = observed(poses(10), noise_px=0.03, points=bent)
    flat = characterise(seen, BOARD, CAMERA.size, SQUARE.size)
    fitted = characterise(seen, BOARD.model_copy(update={"tolerance_mm": 0.1}), CAMERA.size, SQUARE.size)
    assert flat.calibration.rms_px["joint"] > 2 * 0.03 * np.sqrt(2)
    assert fitted.calibration.rms_px["joint"] == pytest.approx(0.03 * np.sqrt(2), rel=0.12)
    heights = fitted.board[:, 2]
    assert np.corrcoef(heights, bend)[0, 1] > 0.99
    assert fitted.leave_one_out_px["camera"] < 0.5 * flat.leave_one_out_px["camera"]  # type: ignore[index]


def test_a_pose_in_which_something_moved_is_left_out_and_named() -> None:
    seen = observed(poses(6), noise_px=0.05)
    moved = RigidTransform.from_vectors(np.array([0, 0.05, 0]), np.array([2.0, 0, 0]))
    light = SQUARE.project((moved @ poses(6)[2]).apply(BOARD.points()), PAIR)
    seen[2] = replace(seen[2], projector_px=light)
    found = characterise(seen, BOARD, CAMERA.size, SQUARE.size)
    assert list(found.left_out) == ["pose_2"]
    assert "moved" in found.left_out["pose_2"]
    assert [o.name for o in found.observations] == ["pose_0", "pose_1", "pose_3", "pose_4", "pose_5"]
    assert found.calibration.rms_px["joint"] < 0.08


def test_too_few_poses_are_refused_naming_each() -> None:
    left_out = {"pose_7": "pose_7: the board was not found", "pose_8": "pose_8: too dark"}
    with pytest.raises(
        CalibrationError, match=r"only 2 of 4 poses .* at least 3 .*pose_7: .*pose_8: too dark"
    ):
        characterise(observed(poses(2)), BOARD, CAMERA.size, SQUARE.size, left_out=left_out)


def test_left_out_poses_are_reported() -> None:
    left_out = {"pose_9": "pose_9: the board was not found"}
    found = characterise(observed(poses(4)), BOARD, CAMERA.size, SQUARE.size, left_out=left_out)
    assert found.left_out == left_out


def test_poses_without_tilt_are_refused() -> None:
    flat = [pose((0, 0, 0), (x, 0, 250)) for x in (-10, 0, 10, 20)]
    with pytest.raises(CalibrationError, match="tilt"):
        characterise(observed(flat, noise_px=0.05), BOARD, CAMERA.size, SQUARE.size)


def test_poses_tilted_too_little_are_refused_with_the_doubt_they_leave() -> None:
    random = np.random.default_rng(0)
    tilts = random.uniform(-2.5, 2.5, (5, 3))
    nearly = [pose(tuple(t), (x, 0, 250)) for t, x in zip(tilts, (-10, 0, 10, 20, 5), strict=True)]  # type: ignore[arg-type]
    with pytest.raises(CalibrationError, match=r"focal length is \d+ ± \d+ px.*tilt"):
        characterise(observed(nearly, noise_px=0.3), BOARD, CAMERA.size, SQUARE.size)


@pytest.mark.parametrize("k3", [False, True])
@pytest.mark.parametrize("tolerance", [None, 0.1])
def test_slopes_are_those_of_the_misfit(k3: bool, tolerance: float | None) -> None:
    seen = observed(poses(3), noise_px=0.5)
    seen[1] = replace(
        seen[1],
        ids=seen[1].ids[5:20],
        camera_px=seen[1].camera_px[5:20],
        projector_px=seen[1].projector_px[5:20],
    )
    start = Solution(
        np.array([2200, 2195, 610, 440, -0.09, 0.12, 5e-4, -3e-4, 0.1]),
        np.array([2600, 2605, 860, 1125, -0.05, 0.02, 2e-4, 1e-4, -0.1]),
        vectors_of(PAIR),
        np.stack([vectors_of(t) for t in poses(3)]),
        BOARD.points(),
    )
    problem = Problem(tuple(seen), start, k3, tolerance, 0.3)
    vector = problem.pack(start)
    slopes = problem.slopes(vector)
    for column in np.random.default_rng(0).choice(len(vector), 30, replace=False):
        step = np.zeros_like(vector)
        step[column] = 1e-6 * max(abs(vector[column]), 1e-2)
        change = problem.misfit(vector + step) - problem.misfit(vector - step)
        np.testing.assert_allclose(
            slopes[:, column],
            change / (2 * step[column]),
            rtol=1e-4,
            atol=1e-4 * np.abs(slopes[:, column]).max() + 1e-7,
        )


# From pictures to points

EYE = Pinhole.from_focal((640, 480), (1100, 1100), (315, 244))
LIGHT = Pinhole.from_focal((912, 1140), (900, 1800), (455, 1120))
PERIODS = (14.25, 17.8125)


@cache
def capture(tilt: float = 25.0) -> tuple[np.ndarray, SimpleNamespace, np.ndarray, np.ndarray]:
    """Image, decoded maps, and the true points of both devices; the maps have the noise of fringes."""
    T = pose((tilt, -15, 10), (1, 2, 190))
    matrix = plane_homography(EYE, T)
    image = render(BOARD, matrix, EYE.size)
    v, u = np.mgrid[0 : EYE.size[1], 0 : EYE.size[0]].astype(np.float64)
    rays = np.stack([*np.moveaxis(EYE.normalise(np.stack([u, v], axis=-1)), -1, 0), np.ones_like(u)], axis=-1)
    normal = T.rotation[:, 2]
    surface = rays * ((normal @ T.translation) / (rays @ normal))[..., None]
    light = LIGHT.project(surface, PAIR)
    light += np.random.default_rng(5).normal(0, 0.15, light.shape) * (150 / image[..., None])
    decoded = SimpleNamespace(u=light[..., 0].astype(np.float32), v=light[..., 1].astype(np.float32),
                              modulation=(0.4 * image).astype(np.float32))  # fmt: skip
    points = T.apply(BOARD.points())
    return image, decoded, EYE.project(points), LIGHT.project(points, PAIR)


def copied(decoded: SimpleNamespace) -> SimpleNamespace:
    return SimpleNamespace(**{k: v.copy() for k, v in vars(decoded).items()})


@pytest.mark.parametrize("periods", [PERIODS, None])
def test_points_are_observed_where_they_are(periods: tuple[float, float] | None) -> None:
    image, decoded, camera, light = capture()
    found = observe("pose", image, decoded, BOARD, periods)  # type: ignore[arg-type]
    assert len(found.ids) == 52
    assert found.repaired == 0
    np.testing.assert_allclose(found.camera_px, camera, atol=0.02)
    # Some 300 pixels of 0.15 to 0.3 px noise bear on each point.
    errors = found.projector_px - light
    assert np.sqrt(np.mean(errors**2)) < 0.03
    assert np.abs(errors.mean(axis=0)).max() < 0.008


def test_wrong_fringe_orders_in_a_patch_do_not_move_the_points() -> None:
    image, decoded, _, light = capture()
    clean = observe("pose", image, decoded, BOARD, PERIODS)  # type: ignore[arg-type]
    wrong = copied(decoded)
    wrong.v[230:330, 150:400] += np.float32(PERIODS[1])
    wrong.u[100:200, 300:420] -= np.float32(PERIODS[0])
    found = observe("pose", image, wrong, BOARD, PERIODS)  # type: ignore[arg-type]
    assert found.repaired > 0.05
    np.testing.assert_allclose(found.projector_px, clean.projector_px, atol=1e-3)
    assert np.sqrt(np.mean((found.projector_px - light) ** 2)) < 0.03


def test_scattered_wrong_orders_are_outliers_even_if_the_period_is_not_known() -> None:
    image, decoded, _, light = capture()
    wrong = copied(decoded)
    struck = np.random.default_rng(2).random(wrong.v.shape) < 0.1
    wrong.v[struck] += np.float32(PERIODS[1])
    found = observe("pose", image, wrong, BOARD)  # type: ignore[arg-type]
    assert np.sqrt(np.mean((found.projector_px - light) ** 2)) < 0.04


def test_points_without_light_are_left_out() -> None:
    image, decoded, camera, light = capture()
    dark = copied(decoded)
    dark.u[:, :250] = dark.v[:, :250] = np.nan
    found = observe("pose", image, dark, BOARD, PERIODS)  # type: ignore[arg-type]
    assert set(np.flatnonzero(camera[:, 0] > 285)) <= set(found.ids)
    assert not set(np.flatnonzero(camera[:, 0] < 245)) & set(found.ids)
    np.testing.assert_allclose(found.projector_px, light[found.ids], atol=0.2)


def test_a_pose_without_board_is_refused_by_name() -> None:
    image, decoded, _, _ = capture()
    with pytest.raises(CalibrationError, match="calm_pose: the board was not found"):
        observe("calm_pose", np.full_like(image, 80.0), decoded, BOARD)  # type: ignore[arg-type]


def test_a_pose_in_the_dark_is_refused_by_name() -> None:
    image, decoded, _, _ = capture()
    dark = copied(decoded)
    dark.u[:] = dark.v[:] = np.nan
    with pytest.raises(CalibrationError, match=r"pose_3: .*lit"):
        observe("pose_3", image, dark, BOARD, PERIODS)  # type: ignore[arg-type]
    with pytest.raises(CalibrationError, match=r"pose_3: .*lit"):
        observe("pose_3", image, dark, BOARD)  # type: ignore[arg-type]


def test_coordinates_of_no_plane_are_refused_by_name() -> None:
    image, decoded, _, _ = capture()
    wild = copied(decoded)
    wild.u[:] = np.random.default_rng(0).uniform(0, 900, wild.u.shape)
    with pytest.raises(CalibrationError, match=r"pose_4: .*plane"):
        observe("pose_4", image, wild, BOARD, PERIODS)  # type: ignore[arg-type]


def test_maps_of_another_size_are_refused() -> None:
    image, decoded, _, _ = capture()
    with pytest.raises(CalibrationError, match="640, 478"):
        observe("pose", image[:-2], decoded, BOARD)  # type: ignore[arg-type]


def test_periods_are_those_of_the_finest_fringes() -> None:
    plan = Plan.load("plan_slstudio_board")
    assert finest_periods(plan, (1824, 1140)) == (114, 71.25)
    with pytest.raises(CalibrationError, match="x and y"):
        finest_periods(Plan.load("plan_slstudio_skull"), (1824, 1140))


# Real captures


@pytest.mark.skipif(not DATA.is_dir(), reason=f"the real captures are not in {DATA}; set FPPLAB_DATA")
def test_real_captures_are_characterised() -> None:
    plan, target = Plan.load("plan_slstudio_board"), Target.load("target_slstudio")
    observations = []
    for name in ("calseq1", "calseq2", "calseq3", "calseq4", "calseq5"):
        frames = [cv2.imread(str(DATA / name / f"{i:02d}.png"), cv2.IMREAD_GRAYSCALE) for i in range(12)]
        decoded = decode(frames, plan, (1824, 1140))
        periods = finest_periods(plan, (1824, 1140))
        observations.append(observe(name, np.mean(frames[:3], axis=0), decoded, target, periods))
    assert [len(o.ids) for o in observations] == [117] * 5
    found = characterise(observations, target, (1688, 1352), (1824, 1140))
    assert found.left_out == {}
    assert found.apart_px["camera"] < 0.243
    assert found.apart_px["projector"] < 0.257
    assert found.apart_px["stereo"] < 0.302
    assert found.calibration.rms_px["camera"] < 0.08
    assert found.calibration.rms_px["projector"] < 0.085
    assert found.leave_one_out_px is not None
    assert found.leave_one_out_px["camera"] < 0.15
    assert found.leave_one_out_px["projector"] < 0.16
    assert found.calibration.camera.matrix[0, 0] == pytest.approx(2191.7, abs=2)
    assert found.calibration.baseline_mm == pytest.approx(166.2, abs=0.4)
    flat = characterise(
        observations, target.model_copy(update={"tolerance_mm": None}), (1688, 1352), (1824, 1140)
    )
    assert flat.calibration.rms_px["camera"] < 0.26
    assert flat.calibration.rms_px["projector"] < 0.29
