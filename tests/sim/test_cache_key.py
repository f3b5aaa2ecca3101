"""The key of a table on disk depends on every number that light depends on, and on nothing else."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from sim.build import SceneState, build_scene
from sim.light.cache import table_digest
from sim.scene import RenderScene, SubpixelView
from tests.sim.conftest import plain, world


def scene() -> RenderScene:
    """A scene with a value in every field that can have one."""
    of = world(
        camera={**plain()["camera"], "focus_mm": 450.0},
        projector={**plain()["projector"], "focus_mm": 475.0},
    )
    board = build_scene(of, SceneState("board"))[0]
    body = build_scene(of, SceneState("pillars"))[0].surfaces[0]
    return dataclasses.replace(board, surfaces=(*board.surfaces, body))


SCENE = scene()
SHIFTED = [SubpixelView((0.25, -0.25), (0.5, 0.1)), SubpixelView((-0.25, 0.25), (-0.5, 0.3))]
KNOWN = table_digest(SCENE, SHIFTED)


def numbers(value: object, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The place of every number or name, or array of numbers."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from numbers(getattr(value, field.name), (*path, field.name))
    elif isinstance(value, tuple | list):
        for i, part in enumerate(value):
            yield from numbers(part, (*path, i))
    elif value is not None:
        yield path


def altered(value: Any, path: tuple[Any, ...], which: float) -> Any:
    """The same with the least change of the number at a place; in an array at the fraction `which`."""
    if path:
        first, rest = path[0], path[1:]
        if isinstance(first, str):
            return dataclasses.replace(value, **{first: altered(getattr(value, first), rest, which)})
        return type(value)(altered(v, rest, which) if i == first else v for i, v in enumerate(value))
    if isinstance(value, np.ndarray):
        changed = value.copy()
        place = np.unravel_index(int(which * value.size), value.shape)
        changed[place] = altered(value[place].item(), (), which)
        return changed
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return f"{value}x"
    return value ^ 1 if isinstance(value, int) else float(np.nextafter(value, np.inf))


PLACES = list(numbers((SCENE, SHIFTED)))


def test_the_scene_has_the_expected_fields() -> None:
    named = {str(p[-1] if isinstance(p[-1], str) else p[-2]) for p in PLACES}
    assert {"vertices", "faces", "uv", "picture", "T_camera_item", "distortion", "circles", "window"} < named
    assert {"reflectance", "slope", "depth_mm", "diameter_mm", "exact", "fill", "shift", "lens"} < named


@pytest.mark.parametrize("place", PLACES, ids=lambda place: ".".join(map(str, place)))
def test_any_one_number_changes_the_name(place: tuple[Any, ...]) -> None:
    """By the least change of the number; in arrays at both ends and in the middle."""
    for which in (0.0, 0.37, 0.999999):
        assert table_digest(*altered((SCENE, SHIFTED), place, which)) != KNOWN


def test_the_name_depends_on_nothing_else() -> None:
    assert table_digest(scene(), list(SHIFTED)) == KNOWN
    assert table_digest(SCENE, SHIFTED[::-1]) != KNOWN
    assert table_digest(SCENE, SHIFTED[:1]) != KNOWN
    assert table_digest(dataclasses.replace(SCENE, surfaces=SCENE.surfaces[::-1]), SHIFTED) != KNOWN
