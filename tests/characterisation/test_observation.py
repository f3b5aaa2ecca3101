"""From pictures to points: what belongs to the board is found, and mended where orders are wrong."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from fpplab.characterisation import finest_periods, observe
from fpplab.characterisation.limits import USUAL_LIMITS
from fpplab.characterisation.observation import _find_edge_pixels
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import Pinhole
from fpplab.patterns.plan import Plan
from tests.support.boards import plane_homography, pose, render
from tests.support.rigs import BOARD, PAIR

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


def test_pixels_count_by_their_modulation() -> None:
    """Half of them have a tenth of the modulation and ten times the noise; the others settle the points."""
    image, decoded, _, light = capture()
    random = np.random.default_rng(8)
    mixed = copied(decoded)
    mixed.modulation[:] = np.where(random.random(mixed.u.shape) < 0.5, 100.0, 10.0)
    mixed.u += random.normal(0, 30 / mixed.modulation)
    mixed.v += random.normal(0, 30 / mixed.modulation)
    found = observe("pose", image, mixed, BOARD)  # type: ignore[arg-type]
    # Some 150 strong pixels of 0.3 px noise bear on each point; if all counted alike, it would be 0.2 px.
    assert np.sqrt(np.mean((found.projector_px - light) ** 2)) < 0.08


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("share", [0.5, 0.9, 1.1, 2.0])
def test_an_edge_is_where_the_modulation_changes_by_too_great_a_share(share: float, axis: int) -> None:
    limit = USUAL_LIMITS.max_modulation_gradient
    ramp = np.exp(share * limit * np.arange(40.0))
    modulation = np.broadcast_to(ramp, (40, 40)).astype(np.float32)
    edges = _find_edge_pixels(modulation if axis else modulation.T, limit)[8:-8, 8:-8]
    assert edges.all() == edges.any() == (share > 1.0)


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
    with pytest.raises(CalibrationError, match=r"pose_3: .*illuminated"):
        observe("pose_3", image, dark, BOARD, PERIODS)  # type: ignore[arg-type]
    with pytest.raises(CalibrationError, match=r"pose_3: .*illuminated"):
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
