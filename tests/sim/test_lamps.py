"""Lamps of the room: exact on planes and spheres, with shadows as a ray caster and Blender see them."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image as Pillow

from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from sim.build import SceneState, build_scene
from sim.effects.room_lamp import RoomLamp
from sim.light import Light, PatternLevels, ShownPattern
from sim.light.lamps import lamp_light, point_lamps
from sim.parameters import UNCERTAIN, TwinParameters
from sim.preview_file import Preview, write_preview
from sim.sensor import SensorModel
from sim.sheet import surroundings_surfaces
from sim.twin import Twin
from sim.worker import Blender
from sim.world import World
from tests.sim.conftest import SIZE, plain, world
from tests.sim.raycaster import Box, Plane, Shape, Sphere

LAMP = {"irradiance": 0.25, "angle_deg": 55.0, "azimuth_deg": 160.0, "distance_mm": 600.0}
PATTERNS = make_patterns(Plan(fringes=(Sinusoid(axis="x", stripes=16, steps=3),)), (912, 1140), "diamond")


def lamped(**changes: Any) -> World:
    return world(lamps={"room": LAMP}, **changes)


def all_pixels(of: World) -> tuple[Any, Any]:
    rows, columns = np.mgrid[: of.camera.size[1], : of.camera.size[0]]
    return rows.ravel(), columns.ravel()


def rays_of(of: World) -> Floats:
    rows, columns = all_pixels(of)
    points = np.stack([columns, rows], axis=-1).astype(np.float64)
    return np.column_stack([of.camera_model().normalise(points), np.ones(len(points))])


def expected(of: World, shapes: list[Shape]) -> tuple[Floats, Floats]:
    """Light (P,) of the lamp by the formula on what rays meet first, and how far away it is."""
    rays, place = rays_of(of), np.array(point_lamps(of)[0].place)
    met = [shape.meet(np.zeros(3), rays) for shape in shapes]
    nearest = np.argmin([length for length, _ in met], axis=0)
    length = np.take_along_axis(np.stack([one for one, _ in met]), nearest[None], axis=0)[0]
    normals = np.take_along_axis(np.stack([n for _, n in met]), nearest[None, :, None], axis=0)[0]
    points = np.where(np.isfinite(length), length, 0.0)[:, None] * rays
    ways = place - points
    away = np.linalg.norm(ways, axis=1)
    light = LAMP["irradiance"] * LAMP["distance_mm"] ** 2 * (ways * normals).sum(axis=1) / away**3
    blocked = np.min([shape.meet(place, -ways)[0] for shape in shapes], axis=0) < 1 - 1e-5
    return np.where(np.isfinite(length) & ~blocked, np.maximum(light, 0.0), 0.0), length


def placed(of: World, item: str) -> RigidTransform:
    T = build_scene(of, SceneState(item))[0].surfaces[0].T_camera_item
    return RigidTransform(T[:3, :3], T[:3, 3])


def test_place_of_a_lamp_is_as_documented() -> None:
    """From the camera's axis at the projector's distance: angle 0 behind the camera, azimuth 90 below."""
    of = world(lamps={"a": {"irradiance": 1.0, "angle_deg": 0.0, "distance_mm": 500.0}})
    assert np.allclose(point_lamps(of)[0].place, (0.0, 0.0, of.projector.distance_mm - 500.0))
    below = RoomLamp(irradiance=1.0, angle_deg=90.0, azimuth_deg=90.0, distance_mm=300.0)
    right = RoomLamp(irradiance=1.0, angle_deg=90.0, azimuth_deg=0.0, distance_mm=300.0)
    assert np.allclose(below.displacement_mm, (0.0, 300.0, 0.0))
    assert np.allclose(right.displacement_mm, (300.0, 0.0, 0.0))


def test_light_on_a_card_is_the_formulas() -> None:
    of = lamped()
    pose = placed(of, "card")
    found = lamp_light(of, build_scene(of, SceneState("card"))[0], all_pixels(of))
    normal = pose.rotation[:, 2] * -np.sign(pose.rotation[2, 2])
    true, _ = expected(of, [Plane(pose.translation, normal)])
    assert true.min() > 0.02
    assert np.ptp(true) > 0.02
    np.testing.assert_allclose(found, true, rtol=1e-5)


def test_light_on_a_facing_card_at_that_point_is_the_irradiance() -> None:
    """Where the lamp's place is given from, on a card that faces it."""
    lamp = RoomLamp(irradiance=0.3, angle_deg=40.0, azimuth_deg=0.0, distance_mm=800.0)
    card = {"card_mm": [100, 100], "pose": {"rotation_deg": [0, -40, 0], "translation_mm": [0, 0, 475]}}
    data = plain(lamps={"a": lamp.model_dump()}, items={"facing": card})
    data["camera"] |= {"distortion": [0.0] * 5, "centre_offset_px": [0.5, 0.5]}
    of = world(**data)
    width, height = of.camera.size
    pixel = (np.array([height // 2]), np.array([width // 2]))
    assert np.allclose(of.camera_model().normalise(np.array([[width // 2, height // 2]])), 0.0)
    found = lamp_light(of, build_scene(of, SceneState("facing"))[0], pixel)
    np.testing.assert_allclose(found, 0.3, rtol=1e-4)


@pytest.fixture
def ball_over_plate(tmp_path: Path) -> tuple[World, list[Shape]]:
    """A ball that throws a shadow on a plate, as mesh and as formulas."""
    centre, radius = np.array([0.0, 0.0, 25.0]), 12.0
    ball = trimesh.creation.icosphere(6, radius)
    ball.apply_translation(centre)
    plate = trimesh.creation.box((120.0, 90.0, 4.0))
    trimesh.util.concatenate([ball, plate]).export(tmp_path / "part.stl")
    pose = {"rotation_deg": [180, 0, 0], "translation_mm": [0, 0, 460]}
    of = lamped(items={"part": {"mesh": str(tmp_path / "part.stl"), "pose": pose}})
    there = placed(of, "part")
    half = np.array([60.0, 45.0, 2.0])
    return of, [Sphere(there.apply(centre), radius), Box(-half, half, there)]


@pytest.mark.whole
def test_light_on_bodies_has_their_shadows(ball_over_plate: tuple[World, list[Shape]]) -> None:
    of, shapes = ball_over_plate
    found = lamp_light(of, build_scene(of, SceneState("part"))[0], all_pixels(of))
    true, length = expected(of, shapes)
    lit, shaded = true > 0, np.isfinite(length) & (true == 0)
    assert lit.sum() > 5_000
    assert shaded.sum() > 150
    off = np.abs(found - true)
    assert np.mean(off[lit] > 2e-3) < 0.01, "facets of the ball, and pixels at edges of shadows"
    assert np.mean(found[shaded] > 0) < 0.1


@pytest.mark.whole
def test_light_of_the_room_is_what_is_reflected_of_it(ball_over_plate: tuple[World, list[Shape]]) -> None:
    """Without the projector, of a board: reflectance times ambient light and lamp."""
    of = lamped(ambient=0.02)
    light, setup = Light(of, Blender("bench"), analytic=True), SceneState("board", 0)
    table = light.table(setup)
    own = lamp_light(of, build_scene(of, setup)[0], all_pixels(of)).reshape(of.camera.size[::-1])
    np.testing.assert_allclose(light.irradiance(setup, None), (0.02 + own) * table.albedo, atol=1e-6)
    rows, columns = (one.ravel() for one in np.mgrid[4:124:9, 3:190:7])
    whole = np.stack([light.irradiance(setup, ShownPattern(PATTERNS, n)) for n in range(3)])
    some = light.irradiance_at(setup, PATTERNS, (rows, columns))
    np.testing.assert_allclose(some, whole[:, rows, columns], atol=1e-6)


def test_share_of_lamps_is_that_of_pictures_with_and_without_them() -> None:
    setup, pixels = SceneState("board", 0), (np.array([40, 64, 90]), np.array([60, 90, 120]))
    both, even = (Light(of(ambient=0.02), Blender("bench"), analytic=True) for of in (lamped, world))
    share, room = both.lamp_share(setup), both.irradiance(setup, None)
    on_board = room > 0.2 * room.max()
    np.testing.assert_allclose(
        (share * room)[on_board], (room - even.irradiance(setup, None))[on_board], atol=1e-6
    )
    np.testing.assert_allclose(both.lamp_share(setup, pixels), share[pixels], rtol=1e-6)
    assert share[pixels].min() > 0.3
    assert not even.lamp_share(setup).any()


def test_lamps_alone_are_light_enough() -> None:
    """Nothing is left out because there is no ambient light."""
    light = Light(lamped(), Blender("bench"), analytic=True)
    assert light.irradiance(SceneState("board", 0), None).max() > 0.03
    dark = Light(world(lamps={"room": LAMP | {"irradiance": 0.0}}), Blender("bench"), analytic=True)
    assert not dark.irradiance(SceneState("board", 0), None).any()


def seen(parameters: TwinParameters, twin: Twin, pixels: Any) -> PatternLevels:
    twin = twin.with_parameters(parameters)
    return twin.expected_at(0, PATTERNS, CameraSettings(0.02), pixels)


@pytest.mark.nightly
def test_slopes_of_the_light_hold_for_the_lamps_light() -> None:
    """Reflectance changes with the place on the print, the lamp's light hardly."""
    of = lamped(ambient=0.02)
    light, setup = Light(of, Blender("bench"), analytic=True), SceneState("board", 0)
    found = light.differentiated(setup)
    assert found is not None
    rows, columns = (one.ravel() for one in np.mgrid[30:90:3, 60:130:3])
    irradiance, slopes = found.at(PATTERNS, (rows, columns))
    np.testing.assert_allclose(irradiance, light.irradiance_at(setup, PATTERNS, (rows, columns)), atol=1e-6)
    without = Light(world(ambient=0.02), Blender("bench"), analytic=True).differentiated(setup)
    assert without is not None
    lamp = lamp_light(of, build_scene(of, setup)[0], (rows, columns))
    more = slopes - without.at(PATTERNS, (rows, columns))[1]
    table = without._trace_motion((rows, columns))
    true = np.broadcast_to(lamp[:, None] * table.albedo_slopes, (len(PATTERNS), len(lamp), 2))
    np.testing.assert_allclose(more[..., :2], true, atol=1e-6)
    np.testing.assert_allclose(more[..., 2:], 0.0, atol=1e-7)


@pytest.mark.whole
def test_vibration_moves_what_the_lamp_lights() -> None:
    """The lamp's part of a picture of a displaced board, against the board at that place."""
    step = np.array([[0.008, -0.006, 0.004]])
    parts = []
    for of in (lamped(), world()):
        light, setup = Light(of, Blender("bench"), analytic=True), SceneState("board", 0)
        found = light.differentiated(setup)
        assert found is not None
        there = SceneState("board", held=placed(of, "board").moved(step[0]))
        still, moved = (next(found.displaced(PATTERNS[:1], by)) for by in (np.zeros((1, 3)), step))
        true_still, true_moved = (light.irradiance(one, ShownPattern(PATTERNS, 0)) for one in (setup, there))
        parts.append((still, moved, true_still, true_moved))
    still, moved, true_still, true_moved = (lamp - dark for lamp, dark in zip(*parts, strict=True))
    np.testing.assert_allclose(still, true_still, atol=1e-6)
    change = np.abs(true_moved - true_still).max()
    assert change > 1e-4
    assert np.abs(moved - true_moved).max() < 0.25 * change, "edges of the print are not straight"


def test_a_twin_has_the_lamp_that_it_is_given() -> None:
    twin = Twin.of(lamped(), "board", Blender("bench"))
    now = twin.parameters
    assert (now.lamp_irradiance, now.lamp_angle_deg, now.lamp_azimuth_deg) == (0.25, 55.0, 160.0)
    pixels = (np.full(8, 64), np.arange(80, 112, 4))
    bright = seen(now, twin, pixels)
    dark = seen(replace(now, lamp_irradiance=0.0), twin, pixels)
    assert "room" not in twin.with_parameters(replace(now, lamp_irradiance=0.0)).world.lamps
    assert (bright > dark + 0.5).all()
    np.testing.assert_allclose(seen(now, twin, pixels), bright)


def test_uncertainty_of_the_lamp_is_written(tmp_path: Path) -> None:
    """By the paths of its fields, so that draws of the world have other lamps."""
    twin = Twin.of(lamped(), "board", Blender("bench"))
    twin = twin.with_parameters(
        replace(twin.parameters, sigma={"lamp_irradiance": 0.01, "lamp_angle_deg": 3.0})
    )
    twin.save(tmp_path, CameraSettings(0.02))
    found = World.load(tmp_path / "world.yaml")
    assert found.uncertainty == {"lamps.room.irradiance": 0.01, "lamps.room.angle_deg": 3.0}
    drawn = found.drawn(3)
    assert drawn.lamps["room"].angle_deg != found.lamps["room"].angle_deg
    assert set(UNCERTAIN.values()) >= set(found.uncertainty)


def plate_in_the_way(folder: Path) -> dict[str, Any]:
    """Surroundings between lamp and items, which the camera does not see."""
    lamp = np.array(point_lamps(lamped())[0].place)
    middle = np.array([0.0, 0.0, lamped().projector.distance_mm])
    plate = trimesh.creation.box((150.0, 150.0, 150.0))
    plate.apply_translation(middle + 0.6 * (lamp - middle))
    plate.export(folder / "plate.ply")
    Pillow.fromarray(np.full(SIZE[::-1], 255, np.uint8)).save(folder / "plate.png")
    return {"mesh": str(folder / "plate.ply"), "picture": str(folder / "plate.png"), "reflectance": 0.5}


@pytest.mark.whole
def test_surroundings_throw_no_shadow_of_lamps(tmp_path: Path) -> None:
    plate = plate_in_the_way(tmp_path)
    pixels = (np.full(8, 64), np.arange(80, 112, 4))
    of = lamped(surroundings=plate)
    of_item = build_scene(of, SceneState("board", 0), surroundings_surfaces(of))[0]
    alone = build_scene(lamped(), SceneState("board", 0))[0]
    true = lamp_light(lamped(), alone, pixels)
    assert true.min() > 0.02
    np.testing.assert_allclose(lamp_light(of, of_item, pixels), true, rtol=1e-4)
    shading = [replace(one, shades_room=True) for one in of_item.surfaces]
    assert not lamp_light(of, replace(of_item, surfaces=tuple(shading)), pixels).any()


@pytest.mark.nightly
@pytest.mark.parametrize("surrounded", [False, True])
@pytest.mark.parametrize("item", ["board", "pillars"])
def test_blender_shows_the_same_light(blender: Blender, tmp_path: Path, item: str, surrounded: bool) -> None:
    """The preview's lamps and shadows against the twin's own."""
    around = {"surroundings": plate_in_the_way(tmp_path)} if surrounded else {}
    of = lamped(ambient=0.05, mounted=item, **around)
    setup, light = SceneState(item), Light(of, blender)
    wanted = light.pattern_render(setup, PATTERNS[1])
    scale = SensorModel.of(of).grey_scale(CameraSettings(0.02))
    with (tmp_path / "rig.npz").open("wb") as stream:
        write_preview(Preview("rig", item, wanted, scale), stream)
    program = (
        "import sys, bpy, numpy; from sim.blender.preview import show_preview, take_picture; "
        "from sim.preview_file import read_preview; folder = sys.argv[1]; "
        "bpy.ops.wm.read_factory_settings(use_empty=True); preview = read_preview(folder + '/rig.npz'); "
        "show_preview(bpy.context.scene, preview); "
        "numpy.save(folder + '/picture.npy', take_picture(bpy.context.scene, preview))"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", program, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    picture = np.load(tmp_path / "picture.npy")
    true = scale.levels(light.irradiance(setup, ShownPattern(PATTERNS, 1)))
    off = np.abs(picture - true)
    assert true.max() > 150
    assert np.mean(off > 1.0) < 2e-3
