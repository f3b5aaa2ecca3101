"""Falloff of the projector: light of every mirror, in all that is computed from it."""

from pathlib import Path

import numpy as np
import pytest

from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import uniform_patterns
from sim.build import SceneState
from sim.effects.falloff import ProjectorFalloff
from sim.light import Light, ShownPattern
from sim.twin import Twin
from sim.worker import Blender
from sim.world import ProjectorWorld, World

FALLOFF = (0.1, -0.05, -0.2, 0.03, -0.1)


def world(falloff: tuple[float, ...]) -> World:
    data = World.load("world_twin").binned(8).model_dump(mode="json")
    data["projector"]["falloff"] = list(falloff)
    data["render"] |= {"computed_subpixels": 2, "cache": False}
    return config.validate(data, World, "world")


@pytest.mark.parametrize(("lattice", "rows"), [(Lattice.SQUARE, 101), (Lattice.DIAMOND, 201)])
def test_it_is_a_polynomial_from_the_middle(lattice: Lattice, rows: int) -> None:
    """On the diamond lattice rows lie half as far apart as columns, so the same place has the same light."""
    section = ProjectorWorld(
        size=(201, rows),
        lattice=lattice,
        T_camera_projector=World.load("world_twin").projector.T_camera_projector,
        falloff=FALLOFF,
    )
    light = ProjectorFalloff().mirror_light(section)
    assert light is not None
    assert light[rows // 2, 100] == pytest.approx(1.0, abs=0.002)
    assert light[rows // 2, 200] == pytest.approx(1 + 0.1 - 0.2, abs=0.005)
    assert light[rows // 2, 0] == pytest.approx(1 - 0.1 - 0.2, abs=0.005)
    assert light[rows - 1, 100] == pytest.approx(1 - 0.05 * 0.5 - 0.1 * 0.25, abs=0.005)
    assert ProjectorFalloff().mirror_light(section.model_copy(update={"falloff": (0.0,) * 5})) is None


def test_a_board_is_lit_by_it() -> None:
    """White on the board is the even light times that of the mirrors that light it."""
    blender = Blender("test")  # boards are computed, so it never starts
    even, fallen = (Light(world(one), blender, analytic=True) for one in ((0.0,) * 5, FALLOFF))
    white = ShownPattern(tuple(uniform_patterns((255,), (912, 1140))), 0)
    one, other = even.irradiance(SceneState("board"), white), fallen.irradiance(SceneState("board"), white)
    seen = one > 0.3
    ratio = other[seen] / one[seen]
    table, texture = even.table(SceneState("board")), even._built(SceneState("board"))[2]
    places = table.samples[..., :2].mean(axis=0)
    left, top = table.corner
    row, column = np.argwhere(seen).T
    inside = places[row - top, column - left] - texture.affine[:, 2]
    u, v = (inside @ np.linalg.inv(texture.affine[:, :2]).T).T
    x, y = (u - 455.5) / 456, (v - 569.5) / 912
    wanted = 1 + 0.1 * x - 0.05 * y - 0.2 * x * x + 0.03 * x * y - 0.1 * y * y
    assert np.median(np.abs(ratio / wanted - 1)) < 1e-3
    assert np.ptp(wanted) > 0.02
    blender.close()


def test_a_matched_twin_keeps_it(tmp_path: Path) -> None:
    blender = Blender("test")
    twin = Twin.of(world(FALLOFF), "board", blender)
    assert twin.parameters.projector_falloff == FALLOFF
    twin.save(tmp_path, CameraSettings(0.02))
    assert World.load(str(tmp_path / "world.yaml")).projector.falloff == FALLOFF
    blender.close()
