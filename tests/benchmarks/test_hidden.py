"""Hidden benches: every effect does what it says, and nothing else is there."""

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np
import pytest

from benchmarks.hidden.effects import Effects, Falloff, Print, SecondLamp, drawn_effects
from benchmarks.hidden.foreign import KINDS, SESSION_FRAMES, Foreign, drawn_foreign
from benchmarks.hidden.light import HiddenLight, bend, camera_gain, falloff
from benchmarks.hidden.worlds import BOARD, MOVED, PAINTED, SHAPES, drawn_world, nominal_world
from fpplab.core.conventions import Floats
from fpplab.patterns.fringes import Pattern, uniform_patterns
from sim.build import SceneState
from sim.items import item_poses
from sim.light import Light, PatternLevels, ShownPattern
from sim.worker import Blender
from sim.world import BoardItem, World

SEED = 1


@pytest.fixture(scope="module")
def world() -> World:
    return drawn_world(SEED, poses=2, binning=8)


@pytest.fixture(scope="module")
def blender() -> Iterator[Blender]:
    process = Blender("test")  # boards are computed, so it never starts
    yield process
    process.close()


@pytest.fixture(scope="module")
def plain(world: World, blender: Blender) -> Light:
    return Light(world, blender, analytic=True)


def white(world: World) -> tuple[Pattern, ...]:
    return tuple(uniform_patterns((255,), world.projector.size))


def board_pixels(
    light: Light, world: World
) -> tuple[SceneState, np.ndarray[tuple[int, int], np.dtype[np.bool_]]]:
    setup = SceneState(BOARD)
    return setup, light.irradiance(setup, ShownPattern(white(world), 0)) > 0.2


@pytest.mark.nightly
def test_without_effects_the_light_is_the_worlds(world: World, blender: Blender, plain: Light) -> None:
    hidden = HiddenLight(world, blender, Effects(SEED))
    show = ShownPattern(white(world), 0)
    setup, seen = board_pixels(plain, world)
    one, other = plain.irradiance(setup, show)[seen], hidden.irradiance(setup, show)[seen]
    # the print is stored in 255 levels of the brightest place
    assert np.abs(other / one - 1.0).max() < 0.02
    assert np.abs(other / one - 1.0).mean() < 1e-3


@pytest.mark.nightly
def test_the_falloff_is_that_of_the_projectors_image(world: World, blender: Blender, plain: Light) -> None:
    effects = Effects(SEED, projector=Falloff(0.2, (0.1, -0.2), (0.03, -0.02)))
    hidden, show = HiddenLight(world, blender, effects), ShownPattern(white(world), 0)
    setup, seen = board_pixels(plain, world)
    dark = plain.irradiance(setup, None)
    ratio = ((hidden.irradiance(setup, show) - dark)[seen]) / (plain.irradiance(setup, show) - dark)[seen]
    points, _ = hidden._surface(setup)
    u, v = np.moveaxis(world.projector_model().project(points, world.T_projector_camera()), -1, 0)
    wanted = falloff(effects.projector, u, v, world.projector.size)
    assert (
        np.nanmax(np.abs(ratio - wanted[seen])) < 2e-3
    )  # NaN where only a corner of the pixel sees the board
    assert np.nanmax(wanted) - np.nanmin(wanted) > 0.01
    middle = np.array([0.5 * world.projector.size[0] - 0.5]), np.array([0.5 * world.projector.size[1] - 0.5])
    assert falloff(Falloff(0.2, (1.0, 0.0)), *middle, world.projector.size) == pytest.approx(0.8)


@pytest.mark.nightly
def test_a_bent_board_lies_elsewhere_on_the_projector(world: World, blender: Blender) -> None:
    """By as much as its points lie elsewhere; that of the samples is their mean."""
    flat, bent = (
        HiddenLight(world, blender, Effects(SEED, board=board)) for board in (Print(), Print(sag_mm=0.05))
    )
    setup = SceneState(BOARD)
    tables = [one.table(setup) for one in (flat, bent)]
    lit = np.all(tables[0].samples[..., 3] > 0.2, axis=0)
    texture = flat._built(setup)[2]
    moved = np.mean(tables[1].samples[..., :2] - tables[0].samples[..., :2], axis=0)[lit]
    shift = moved @ np.linalg.inv(texture.affine[:, :2]).T
    pose, (left, top) = item_poses(world, BOARD)[0], tables[0].corner
    height, width = lit.shape
    points = flat._surface(setup)[0][top : top + height, left : left + width][lit]
    on_board = pose.inverse().apply(points)
    half = np.array([30.0, 21.0])
    for _ in range(3):  # where the ray meets the bent board, by iteration instead of by a formula
        up = bend(Print(sag_mm=0.05), on_board[:, :2], half)
        normal = pose.rotation[:, 2]
        along = (normal @ pose.translation + up) / (points @ normal)
        hit = points * along[:, None]
        on_board = pose.inverse().apply(hit)
    model, to_projector = world.projector_model(), world.T_projector_camera()
    wanted = model.project(hit, to_projector) - model.project(points, to_projector)
    assert np.abs(wanted).max() > 0.02
    assert np.abs(shift - wanted).max() < 2e-3


@pytest.mark.whole
def test_the_print_of_a_bent_board_moves_with_it(world: World, blender: Blender, plain: Light) -> None:
    flat, bent = (
        HiddenLight(world, blender, Effects(SEED, board=board)) for board in (Print(), Print(sag_mm=0.5))
    )
    setup = SceneState(BOARD)
    one, other = (light.table(setup).albedo.astype(np.float64) for light in (flat, bent))
    assert np.abs(one - other).max() > 0.02
    assert one.sum() == pytest.approx(other.sum(), rel=0.01)


@pytest.mark.whole
def test_grain_is_the_boards(world: World, blender: Blender) -> None:
    """The same places are dark in both poses, as strong as stated."""
    light = HiddenLight(world, blender, Effects(SEED, board=Print(mottle=0.05, mottle_mm=5.0)))
    plain = HiddenLight(world, blender, Effects(SEED))
    found = []
    for pose in item_poses(world, BOARD):
        setup = SceneState(BOARD, held=pose)
        ratio = light.table(setup).albedo / np.maximum(plain.table(setup).albedo, 1e-6)
        places = world.camera_model().project(pose.apply(_grid()))
        column, row = np.rint(places).astype(int).T
        found.append(ratio[row, column])
    assert np.std(found[0]) == pytest.approx(0.05, rel=0.5)
    assert np.corrcoef(found)[0, 1] > 0.99


def _grid() -> Floats:
    x, y = np.meshgrid(np.linspace(-24, 24, 17), np.linspace(-15, 15, 11))
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1)


@pytest.mark.whole
def test_the_second_lamp_adds_light_by_distance_and_angle(world: World, blender: Blender) -> None:
    card = SecondLamp(level=0.1, place_mm=(0.0, 0.0, -450.0))
    light = HiddenLight(world, blender, Effects(SEED, lamp=card))
    setup = SceneState(BOARD)
    added = light.irradiance(setup, None) - HiddenLight(world, blender, Effects(SEED)).irradiance(setup, None)
    points, normals = light._surface(setup)
    row, column = (int(one) for one in np.argwhere(np.isfinite(points[..., 0])).mean(axis=0))
    point, normal = points[row, column], normals[row, column]
    to_lamp = np.array(card.place_mm) - point
    level = 0.1 * (900.0 / np.linalg.norm(to_lamp)) ** 2 * (to_lamp @ normal) / np.linalg.norm(to_lamp)
    albedo = light.table(setup).albedo[row, column]
    assert light._falloff is not None
    assert added[row, column] == pytest.approx(level * albedo * light._falloff[row, column], rel=1e-3)


def test_gloss_is_greatest_where_the_lamp_is_mirrored(world: World, blender: Blender) -> None:
    light = HiddenLight(world, blender, Effects(SEED, board=Print(gloss=0.2, exponent=30.0)))
    factor = light._gloss(SceneState(BOARD))
    points, normals = light._surface(SceneState(BOARD))
    seen = np.isfinite(points[..., 0])
    assert 1.0 <= factor[seen].min() <= factor[seen].max() <= 1.2
    lamp = world.T_projector_camera().inverse().translation
    incoming = (points - lamp) / np.linalg.norm(points - lamp, axis=-1, keepdims=True)
    mirrored = incoming - 2 * np.sum(incoming * normals, axis=-1, keepdims=True) * normals
    towards = -points / np.linalg.norm(points, axis=-1, keepdims=True)
    angle = np.arccos(np.sum(mirrored * towards, axis=-1)[seen])
    assert np.corrcoef(np.cos(angle / 2) ** 30, factor[seen])[0, 1] > 0.999
    assert (factor[~seen] == 1).all()


def test_the_cameras_gain_has_a_smooth_part_and_one_of_every_pixel(world: World) -> None:
    smooth = camera_gain(world, Effects(SEED, camera=Falloff(0.1)))
    whole = camera_gain(world, Effects(SEED, camera=Falloff(0.1), fixed_pattern=0.01))
    assert smooth.max() == pytest.approx(1.0, abs=1e-5)
    assert smooth.min() < 0.9
    assert np.std(whole / smooth) == pytest.approx(0.01, rel=0.02)


def test_every_effect_is_drawn_and_none_is_absent() -> None:
    one, again, other = drawn_effects(3), drawn_effects(3), drawn_effects(4)
    assert one == again
    absent = Effects(3)
    for field in fields(Effects):
        if field.name != "seed":
            values = [getattr(effects, field.name) for effects in (one, other, absent)]
            assert values[0] != values[1], field.name
            assert values[0] != values[2], field.name


def test_a_world_is_drawn_and_the_twin_does_not_know_it(world: World) -> None:
    assert drawn_world(SEED, 2, 8) == world
    assert drawn_world(2, 2, 8) != world
    nominal = nominal_world(world)
    for part in (*SHAPES, MOVED, PAINTED):
        assert nominal.item(part) == world.item(part).model_copy(update={"material": None})
    assert nominal.camera.size == world.camera.size
    board = nominal.item(BOARD)
    assert isinstance(board, BoardItem)
    assert board.ink is None
    for section in ("projector", "camera", "ambient", "material"):
        assert getattr(nominal, section) != getattr(world, section), section
    assert replace(drawn_effects(SEED), seed=2) != drawn_effects(2)


def test_a_bench_has_one_foreign_effect_and_usually_none(world: World) -> None:
    drawn = [drawn_foreign(kind, SEED) for kind in KINDS]
    assert len(set(drawn)) == len(KINDS)
    none, light = Foreign(SEED), np.full((6, 4), 0.3, np.float32)
    assert none.world(world, 1.0) == world
    assert none.mirrors(light, 0.7) is light
    assert none.seen(light) is light
    assert (none.specks(4, 6, 1) == 1).all()
    assert none.span(10, 32)[0] == none.span(10, 32)[1]


def test_the_projector_drifts_within_a_recording_or_warms_between_two(world: World) -> None:
    drift, warm = Foreign(picture_px=(0.5, -0.2)), Foreign(zoom=1e-3, pointing_deg=(0.02, 0.0))
    begun, ended = drift.span(0, int(SESSION_FRAMES) + 1)
    assert begun == 0
    assert ended == pytest.approx(1 - np.exp(-1))
    assert warm.span(7, 32)[0] == warm.span(7, 32)[1] > 0
    moved = drift.world(world, 0.5).projector_model().matrix - world.projector_model().matrix
    assert moved[:2, 2] == pytest.approx([0.25, -0.1])
    warmed, cold = warm.world(world, 1.0), world
    assert warmed.projector_model().matrix[0, 0] == pytest.approx(1.001 * cold.projector_model().matrix[0, 0])
    turn = warmed.T_projector_camera().rotation @ cold.T_projector_camera().rotation.T
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(0.02, rel=0.05)


def test_the_response_bends_with_the_place_and_keeps_black_and_white() -> None:
    bent = Foreign(bend=(0.05, 0.0, 0.0))
    shown = [bent.mirrors(np.full((3, 5), level, np.float32), 0.8) for level in (0.0, 0.4, 0.8)]
    assert shown[0] == pytest.approx(0.0)
    assert shown[1][1] == pytest.approx(0.4 + 0.05 * 0.2 * np.linspace(-1, 1, 5))
    assert shown[2] == pytest.approx(0.8)


def test_points_spread_further_in_one_direction() -> None:
    point = np.zeros((41, 41), np.float32)
    point[20, 20] = 1.0
    row, column = np.mgrid[-20:21, -20:21]

    def variances(image: PatternLevels) -> tuple[float, float]:
        return float((image * column**2).sum()), float((image * row**2).sum())

    assert variances(Foreign(projector_px=(0.0, 1.5)).mirrors(point, 1.0)) == pytest.approx(
        (0.0, 2.25), rel=0.01
    )
    assert variances(Foreign(projector_px=(1.0, 0.0)).mirrors(point, 1.0)) == pytest.approx(
        (1.0, 0.0), rel=0.01
    )
    across, down = variances(Foreign(camera_px=1.2, camera_deg=90.0).seen(point))
    assert down == pytest.approx(1.44, rel=0.03)
    assert across < 0.01


def test_dust_takes_no_more_than_it_says() -> None:
    taken = 1.0 - Foreign(SEED, speck=0.1).specks(300, 200, 1)
    assert 0.02 < taken.max() < 0.2
    assert np.median(taken) < 1e-3
    assert (taken != 1.0 - Foreign(SEED, speck=0.1).specks(300, 200, 0)).any()
