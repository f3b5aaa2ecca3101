"""Traced light on matt bodies: against Blender at all samples, and which bodies are left to Blender."""

from typing import Any

import numpy as np
import pytest

from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from sim.build import build_scene
from sim.light import Light, SceneState, ShownPattern
from sim.light.lens import lens_points
from sim.light.solid import can_trace, traced
from sim.scene import SubpixelView
from sim.worker import Blender
from sim.world import World
from sim.world.render import subpixel_shifts
from tests.sim.conftest import OTHER_MATERIALS, plain, world

PLAN = Plan(fringes=tuple(Sinusoid(axis="x", stripes=s, steps=3) for s in (1, 64)))
SIZE = [384, 256]
BESIDE = 8e-3
"""Share of samples that Blender may see on another triangle, or in shadow where we do not: it aims some
thousandths of a pixel beside, and pillars are mostly edges."""


def _world(focus_mm: float | None, projector_focus_mm: float | None, subpixels: int = 2) -> World:
    camera = plain()["camera"] | {
        "sensor_size": SIZE,
        "pixel_um": 13132.8 / SIZE[0],
        "f_number": 2.0,
        "focus_mm": focus_mm,
    }
    projector = plain()["projector"] | {"focus_mm": projector_focus_mm, "aperture_mm": 20.0}
    return world(
        camera=camera, projector=projector, render={"subpixels": subpixels, "cache": False}, ambient=0.02
    )


def _pixels(of: World) -> tuple[Any, Any]:
    rows, columns = np.mgrid[: of.camera.size[1], : of.camera.size[0]]
    return rows.ravel(), columns.ravel()


@pytest.mark.whole
@pytest.mark.parametrize(
    ("focus_mm", "projector_focus_mm", "subpixels"),
    [(None, None, 2), (425.0, None, 3), (None, 490.0, 2)],
    ids=["sharp", "camera out of focus", "projector out of focus"],
)
@pytest.mark.parametrize("setup", [SceneState("pillars"), SceneState("pillars", stage_mm=7.0)], ids=str)
def test_traced_light_agrees_with_blender(
    blender: Blender,
    setup: SceneState,
    focus_mm: float | None,
    projector_focus_mm: float | None,
    subpixels: int,
) -> None:
    """Place, circle, light and shadow of every sample."""
    of = _world(focus_mm, projector_focus_mm, subpixels)
    light = Light(of, blender)
    rendered, scene = light.table(setup).at(_pixels(of)), build_scene(of, setup)[0]
    places = subpixel_shifts(subpixels)
    lens = lens_points(len(places)) if focus_mm else [(0.0, 0.0)] * len(places)
    views = [SubpixelView(place, point) for place, point in zip(places, lens, strict=True)]
    table = traced(scene, views, _pixels(of))
    lit, also = table.samples[..., 3] > 0, rendered.samples[..., 3] > 0
    assert lit.sum() > 20_000
    assert np.mean(lit[lit | also] != also[lit | also]) < BESIDE
    off = np.abs(table.samples - rendered.samples)[lit & also]
    tolerance = np.array([5e-3, 5e-3, 1e-3, 2e-4])
    assert np.mean((off > tolerance).any(axis=1)) < BESIDE
    assert np.mean(np.abs(table.albedo - rendered.albedo) > 1e-4) < BESIDE


@pytest.mark.whole
def test_pictures_at_pixels_are_those_of_whole_images(blender: Blender) -> None:
    """Through `Light`, with ambient light: traced at pixels, rendered as a whole."""
    of = _world(440.0, 480.0)
    light, size = Light(of, blender), of.projector.size
    patterns = (*make_patterns(PLAN, size, of.projector.lattice), *uniform_patterns([255], size))
    found = light.irradiance_at(SceneState("pillars"), patterns, _pixels(of))
    for n, one in enumerate(found):
        error = one - light.irradiance(SceneState("pillars"), ShownPattern(patterns, n)).ravel()
        assert np.mean(np.abs(error) > 2e-3) < BESIDE
        assert abs(error.mean()) < 2e-5
    assert found[-1].max() > 0.8


def test_no_pixel_is_seen_outside_the_window() -> None:
    of = _world(None, None)
    scene = build_scene(of, SceneState("pillars"))[0]
    left, top, right, bottom = scene.window
    rows, columns = _pixels(of)
    inside = (rows >= top) & (rows < bottom) & (columns >= left) & (columns < right)
    assert 0 < inside.sum() < inside.size
    table = traced(scene, [SubpixelView((0.0, 0.0))], (rows, columns))
    assert not table.samples[:, 0, ~inside].any()
    assert table.samples[:, 0, inside, 3].any()


@pytest.mark.parametrize("material", OTHER_MATERIALS)
def test_other_materials_are_left_to_blender(material: dict[str, Any]) -> None:
    assert not can_trace(build_scene(world(material=material), SceneState("pillars"))[0])


def test_prints_are_left_to_blender() -> None:
    assert not can_trace(build_scene(world(), SceneState("board"))[0])
    assert can_trace(build_scene(world(), SceneState("pillars"))[0])
