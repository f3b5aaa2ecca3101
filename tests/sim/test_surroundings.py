"""Surroundings and sheets of boards: exact against plain cards, hidden and shaded by items, and as files."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from PIL import Image as Pillow

from fpplab.core import config
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from sim.appearance import Appearance, BenchSurroundings, BoardSheet
from sim.build import NOTHING, SceneState
from sim.items import item_surface
from sim.light import Light, PatternLevels, ShownPattern
from sim.light.background import Background
from sim.sheet import surroundings_surfaces
from sim.twin import Twin
from sim.worker import Blender
from sim.world import World
from tests.sim.conftest import SIZE, plain

PATTERNS = make_patterns(Plan(fringes=(Sinusoid(axis="x", stripes=16, steps=3),)), (912, 1140), "diamond")
WALL = RigidTransform.from_vectors(np.radians([6.0, 10.0, 0.0]), np.array([0.0, 0.0, 560.0]))
EXACT = {"subpixels": 2, "cache": False}
SETTINGS = CameraSettings(0.02, bits=12)


def write_wall(folder: Path, reflectance: float = 0.5, half_mm: float = 400.0) -> dict[str, Any]:
    """A wall's files, and their section in a world file."""
    corners = half_mm * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    mesh = trimesh.Trimesh(WALL.apply(corners), [[0, 2, 1], [0, 3, 2]], process=False)
    mesh.export(folder / "wall.ply")
    Pillow.fromarray(np.full(SIZE[::-1], 255, np.uint8)).save(folder / "wall.png")
    return {
        "mesh": str(folder / "wall.ply"),
        "picture": str(folder / "wall.png"),
        "reflectance": reflectance,
    }


def walled(folder: Path, **changes: Any) -> World:
    """The small world with a wall behind everything, which is an item as well."""
    data = plain(render=EXACT, ambient=0.03, **changes)
    pose = {
        "rotation_deg": np.degrees(WALL.rotation_vector).tolist(),
        "translation_mm": WALL.translation.tolist(),
    }
    data["items"]["wall"] = {"card_mm": [800, 800], "pose": pose, "material": "wall"}
    data["materials"] = {"wall": {"reflectance": 0.5}}
    data["surroundings"] = write_wall(folder)
    return config.validate(data, World, "test")


def seen(of: World, setup: SceneState, index: int = 0) -> PatternLevels:
    return Light(of, Blender("bench"), analytic=True).irradiance(setup, ShownPattern(PATTERNS, index))


@pytest.mark.nightly
def test_the_empty_bench_shows_them_as_the_same_item_would_be_seen(tmp_path: Path) -> None:
    of = walled(tmp_path)
    alone = of.model_copy(update={"surroundings": None})
    np.testing.assert_allclose(
        seen(of, SceneState(NOTHING)), seen(alone, SceneState("wall")), rtol=0.01, atol=2e-4
    )
    assert not seen(alone, SceneState(NOTHING)).any()


@pytest.mark.whole
def test_an_item_hides_and_shades_them(tmp_path: Path) -> None:
    of = walled(tmp_path)
    white = uniform_patterns([255], (912, 1140))
    setup = SceneState("board", 0)
    light = Light(of, Blender("bench"), analytic=True)
    both, item = (
        Light(one, Blender("bench"), analytic=True).irradiance(setup, ShownPattern(white, 0))
        for one in (of, of.model_copy(update={"surroundings": None}))
    )
    empty = light.irradiance(SceneState(NOTHING), ShownPattern(white, 0))
    ambient = 0.03 * 0.5
    is_item = item > 0.2
    inside = cv2.erode(is_item.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    beyond = cv2.dilate((item > 0).astype(np.uint8), np.ones((5, 5), np.uint8)) == 0
    np.testing.assert_allclose(both[inside], item[inside], atol=1e-5)
    shaded = beyond & (np.abs(both - ambient) < 1e-4)
    lit = beyond & (np.abs(both - empty) < 1e-5)
    assert shaded.sum() > 300, "the board throws a shadow"
    assert lit.sum() > 3000
    assert (shaded | lit)[beyond].mean() > 0.95, "and nothing between"


@pytest.mark.nightly
@pytest.mark.parametrize("item", ["board", "pillars"])
def test_some_pixels_are_as_all_are(tmp_path: Path, item: str) -> None:
    of = walled(tmp_path)
    if item == "pillars":
        pytest.importorskip("bpy")
    light = Light(of, Blender("bench"), analytic=True)
    rows, columns = (one.ravel() for one in np.mgrid[4:124:9, 3:190:7])
    whole = (
        np.stack([light.irradiance(SceneState(item), ShownPattern(PATTERNS, n)) for n in range(3)])
        if item == "board"
        else None
    )
    some = light.irradiance_at(SceneState(item), PATTERNS, (rows, columns))
    if whole is not None:
        np.testing.assert_allclose(some, whole[:, rows, columns], atol=1e-6)
    assert (some > 0).mean() > 0.9


@pytest.mark.nightly
@pytest.mark.parametrize("path", ["transport", "linear", "reference"])
def test_all_light_paths_agree(blender: Blender, tmp_path: Path, path: str) -> None:
    of = walled(tmp_path)
    rendered = of.model_copy(update={"render": of.render.model_copy(update={"path": path})})
    setup, show = SceneState("pillars"), ShownPattern(PATTERNS, 1)
    expected = Light(of, blender).irradiance(setup, show)
    found = Light(rendered, blender).irradiance(setup, show)
    assert (expected > 0).mean() > 0.9
    assert np.quantile(np.abs(found - expected), 0.97) < 2e-3


def with_board(of: World, **fields: Any) -> World:
    """The world with further fields of its board."""
    data = of.model_dump(mode="json")
    board = plain()["items"]["board"] | fields
    return config.validate(data | {"items": data["items"] | {"board": board}}, World, "test")


@pytest.mark.whole
def test_a_frame_hides_and_shades_and_is_black(tmp_path: Path) -> None:
    of = walled(tmp_path)
    bare, found = seen(of, SceneState("board")), seen(with_board(of, rim_mm=12.0), SceneState("board"))
    changed = np.abs(found - bare) > 1e-6
    assert changed.sum() > 500
    assert (found[changed] <= bare[changed]).all()
    assert (found[changed] < 1e-6).mean() > 0.3, "the frame itself is black in ambient light too"


@pytest.mark.whole
def test_a_frame_reflects_as_a_sheet_in_its_place(tmp_path: Path) -> None:
    of = walled(tmp_path)
    black, grey, sheet = (
        seen(with_board(of, **fields), SceneState("board"))
        for fields in (
            {"rim_mm": 12.0},
            {"rim_mm": 12.0, "rim_reflectance": 0.2},
            {"margins_mm": (12.0, 12.0, 12.0, 12.0), "reflectance": 0.8},
        )
    )
    frame = (black < 1e-6) & (grey > 1e-3) & (sheet > 0)
    assert frame.sum() > 200
    assert np.median(grey[frame] / sheet[frame]) == pytest.approx(0.25, rel=0.02)


def test_surroundings_do_not_shade_the_room_s_lamps(tmp_path: Path) -> None:
    """What reaches the items past them, or by way of them, is a lamp of the room already."""
    assert [wall.shades_room for wall in surroundings_surfaces(walled(tmp_path))] == [False]


def test_a_sheet_has_margins_and_texture(tmp_path: Path) -> None:
    data = plain(render=EXACT)
    Pillow.fromarray(np.full((10, 12), 96, np.uint8)).save(tmp_path / "texture.png")
    more = {
        "margins_mm": [10, 0, 5, 2],
        "texture": str(tmp_path / "texture.png"),
        "reflectance": 0.8,
        "ink": 0.2,
    }
    changed = config.validate(
        plain(render=EXACT, items=data["items"] | {"board": data["items"]["board"] | more}), World, "test"
    )
    plainer = config.validate(
        plain(
            render=EXACT,
            items=data["items"] | {"board": data["items"]["board"] | {"reflectance": 0.8, "ink": 0.2}},
        ),
        World,
        "test",
    )
    pose = RigidTransform(np.eye(3), np.array([0.0, 0.0, 450.0]))
    sheet, print_alone = (item_surface(of, "board", pose) for of in (changed, plainer))
    low, high = sheet.vertices[0], sheet.vertices[2]
    np.testing.assert_allclose(low - print_alone.vertices[0], [-10, 0, 0])
    np.testing.assert_allclose(high - print_alone.vertices[2], [5, 2, 0])
    assert sheet.picture is not None
    grey = sheet.paint.reflectance * sheet.picture / 255.0
    assert grey.max() == pytest.approx(0.75 * 0.8, abs=2e-3)
    assert grey.min() == pytest.approx(0.75 * 0.2, abs=2e-3)
    assert (grey[:, 0] > 0.59).all(), "margins are blank"


@pytest.mark.whole
def test_what_a_twin_looks_like_is_saved_and_read_again(tmp_path: Path) -> None:
    of = config.validate(plain(render=EXACT), World, "test")
    twin = Twin.of(of, "board", Blender("bench"))
    mesh = trimesh.load(write_wall(tmp_path)["mesh"], process=False)
    texture = np.random.default_rng(1).uniform(0.8, 1.2, (40, 60)).astype(np.float32)
    around = BenchSurroundings(mesh, np.full(SIZE[::-1], 0.3, np.float32))
    twin = twin.with_appearance(Appearance(BoardSheet((5.0, 0.0, 0.0, 5.0), 8.0, 0.06, texture), around))
    shown = twin.expected(0, PATTERNS, SETTINGS)
    twin.save(tmp_path / "saved", SETTINGS)
    again = Twin.of(World.load(tmp_path / "saved" / "world.yaml"), "board", Blender("bench"))
    np.testing.assert_allclose(again.expected(0, PATTERNS, SETTINGS), shown, atol=0.02)
    assert {"surroundings.ply", "surroundings.png", "board_texture.png"} <= {
        one.name for one in (tmp_path / "saved").iterdir()
    }
    text = (tmp_path / "saved" / "world.yaml").read_text()
    assert str(tmp_path) not in text, "it can be moved to another folder"
    twin = twin.with_appearance(Appearance())
    assert np.abs(twin.expected(0, PATTERNS, SETTINGS) - shown).max() > 1


@pytest.mark.whole
@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / "wall.ply").unlink(), "'surroundings.mesh': .*wall.ply"),
        (lambda folder: (folder / "wall.png").write_bytes(b"none"), "'surroundings.picture': .*wall.png"),
        (
            lambda folder: Pillow.new("I;16", SIZE).save(folder / "wall.png"),
            "must be one grey image of 8 bits",
        ),
    ],
    ids=["no mesh", "no picture", "16 bits"],
)
def test_files_that_cannot_be_read_are_named(tmp_path: Path, spoil: Any, message: str) -> None:
    of = walled(tmp_path)
    spoil(tmp_path)
    with pytest.raises(ConfigError, match=message):
        Light(of, Blender("bench"), analytic=True)


@pytest.mark.whole
def test_a_mesh_behind_the_camera_is_refused(tmp_path: Path) -> None:
    of = walled(tmp_path)
    mesh = trimesh.load(tmp_path / "wall.ply", process=False)
    mesh.vertices[0, 2] = -1.0
    mesh.export(tmp_path / "wall.ply")
    with pytest.raises(ConfigError, match="z = -1 mm: must be before the camera"):
        Light(of, Blender("bench"), analytic=True)


@pytest.mark.whole
@pytest.mark.parametrize("axis", [0, 1])
def test_a_picture_lies_on_the_wall_as_the_camera_sees_it(axis: int, tmp_path: Path) -> None:
    of, places = walled(tmp_path), np.mgrid[0 : SIZE[1], 0 : SIZE[0]][axis]
    mesh = trimesh.load_mesh(tmp_path / "wall.ply")
    mesh.subdivide_to_size(10.0).export(tmp_path / "wall.ply")  # within a triangle perspective is left out
    greys = np.rint(20 + 230 * places / places.max()).astype(np.uint8)
    Pillow.fromarray(greys).save(tmp_path / "wall.png")
    around = surroundings_surfaces(of)
    assert around
    seen = Background(of, around).albedo(SceneState("nothing"))
    inside = slice(3, -3), slice(3, -3)
    np.testing.assert_allclose(seen[inside], 0.5 * greys[inside] / 255, atol=0.004)
