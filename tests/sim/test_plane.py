"""Computed light on flat items: against Blender, against the ray caster, and which items are refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from sim.build import build_scene
from sim.items import item_poses
from sim.light import Light, SceneState, ShownPattern
from sim.light.lens import lens_points
from sim.light.plane import can_compute, computed, computed_motion
from sim.light.solid import traced
from sim.scene import RenderScene, SubpixelView
from sim.worker import Blender
from sim.world import World
from sim.world.render import subpixel_shifts
from tests.sim.conftest import OTHER_MATERIALS, plain, world
from tests.sim.raycaster import Caster, Plane

PLAN = Plan(fringes=tuple(Sinusoid(axis="x", stripes=s, steps=3) for s in (1, 64)))
SIZE = [384, 256]


def _world(subpixels: int, focus_mm: float | None, projector_focus_mm: float | None) -> World:
    camera = plain()["camera"] | {
        "sensor_size": SIZE,
        "pixel_um": 13132.8 / SIZE[0],
        "f_number": 2.0,
        "focus_mm": focus_mm,
    }
    projector = plain()["projector"] | {"focus_mm": projector_focus_mm, "aperture_mm": 20.0}
    board = {"target": "target_paper.yaml", "poses": {"count": 4}, "reflectance": 0.8, "ink": 0.1}
    return world(
        camera=camera,
        projector=projector,
        items={**plain()["items"], "board": board},
        render={"subpixels": subpixels, "cache": False},
    )


@pytest.mark.whole
@pytest.mark.parametrize(
    ("subpixels", "focus_mm", "projector_focus_mm"),
    [(2, None, None), (3, 425.0, None), (2, None, 490.0)],
    ids=["sharp", "camera out of focus", "projector out of focus"],
)
@pytest.mark.parametrize(
    "setup", [SceneState("card"), SceneState("board", 1), SceneState("board", 3, stage_mm=7.0)], ids=str
)
def test_computed_light_agrees_with_blender(
    monkeypatch: pytest.MonkeyPatch,
    blender: Blender,
    setup: SceneState,
    subpixels: int,
    focus_mm: float | None,
    projector_focus_mm: float | None,
) -> None:
    """Through the same points of every lens: the pixels' turns are the shader's own.

    Blender aims some thousandths of a pixel beside, so a sample at the item's edge may miss it.
    """
    of = _world(subpixels, focus_mm, projector_focus_mm)
    monkeypatch.setattr("sim.light.light.computed", lambda scene, views, spots: computed(scene, views))
    ours, theirs = Light(of, blender, analytic=True), Light(of, blender)
    table, rendered = ours.table(setup), theirs.table(setup)
    assert table.corner == rendered.corner
    lit, also = table.samples[..., 3] > 0, rendered.samples[..., 3] > 0
    assert lit.sum() > 1000
    assert np.mean(lit[lit | also] != also[lit | also]) < 1e-3
    np.testing.assert_allclose(
        table.samples[lit & also][:, :2], rendered.samples[lit & also][:, :2], atol=5e-3
    )
    np.testing.assert_allclose(table.samples[lit & also][:, 2], rendered.samples[lit & also][:, 2], atol=1e-3)
    (left, top), (_, h, w, _) = table.corner, table.samples.shape
    same = np.ones(table.albedo.shape, bool)
    same[top : top + h, left : left + w] = (lit == also).all(axis=0)
    size = of.projector.size
    patterns = (*make_patterns(PLAN, size, of.projector.lattice), *uniform_patterns([255], size))
    for n in range(len(patterns)):
        show = ShownPattern(patterns, n)
        error = (ours.irradiance(setup, show) - theirs.irradiance(setup, show))[same]
        assert np.sqrt(np.mean(error**2)) < 2e-4


@pytest.mark.whole
@pytest.mark.parametrize("focus_mm", [None, 445.0, 500.0], ids=["sharp", "nearer", "farther"])
@pytest.mark.parametrize("pose", range(2))
def test_few_spots_agree_with_many_points(pose: int, focus_mm: float | None) -> None:
    """Closer to 400 points of pixel and lens than as many independent points are, and without an offset."""

    def seen(subpixels: int, spots: bool) -> NDArray[np.float32]:
        places = subpixel_shifts(subpixels)
        lens = lens_points(len(places)) if focus_mm else [(0.0, 0.0)] * len(places)
        return computed(scene, [SubpixelView(*both) for both in zip(places, lens, strict=True)], spots).albedo

    scene = build_scene(_world(1, focus_mm, None), SceneState("board", pose))[0]

    many, points, spots = seen(20, False), seen(4, False), seen(4, True)
    assert np.std(spots - many) < 0.65 * np.std(points - many)
    assert spots.sum() == pytest.approx(many.sum(), rel=2e-4)
    for slope in np.gradient(many):  # the displacement that explains the difference best
        assert abs(np.sum(slope * (spots - many)) / np.sum(slope**2)) < 5e-3


@pytest.mark.parametrize("turned", [[8, -5, 0], [0, 60, 0], [0, -75, 20], [180, 12, 0]])
@pytest.mark.parametrize("traces", [False, True], ids=["computed", "traced"])
def test_light_agrees_with_the_ray_caster(turned: list[float], traces: bool) -> None:
    """Also on a card that turns its back to the projector, or shows its back to both."""
    pose = {"rotation_deg": turned, "translation_mm": [0, 0, 450]}
    of = world(items={"card": {"card_mm": [2000, 2000], "pose": pose}}, material={"reflectance": 0.7})
    scene = build_scene(of, SceneState("card"))[0]
    views = [SubpixelView((0.0, 0.0))]
    if traces:
        rows, columns = np.indices(of.camera.size[::-1]).reshape(2, -1)
        samples = traced(scene, views, (rows, columns)).samples.reshape(1, *of.camera.size[::-1], 4)
    else:
        samples = computed(scene, views).samples
    held = of.items["card"].pose.transform()  # type: ignore[union-attr]
    normal = held.rotation[:, 2] * -np.sign(held.rotation[:, 2] @ held.translation)
    caster = Caster(of.camera_model(), of.projector_model(), of.T_projector_camera(), 475.0, 0.7)
    seen = caster.look([Plane(held.translation, normal)], 1)
    place = np.stack([seen.u, seen.v, np.ones_like(seen.u)], axis=-1)[0] @ scene.lamp.affine.T
    inside = (seen.shade[0] > 0) & of.projector_model().sees(seen.points[0], of.T_projector_camera())
    inside &= (np.abs(held.inverse().apply(seen.points[0])) < 1000).all(axis=-1)  # where the card is
    lit = samples[0, ..., 3] > 0
    assert inside.sum() > 1000
    assert lit[inside].all()
    assert (seen.shade[0][lit] > 0).all()
    np.testing.assert_allclose(samples[0, inside, :2], place[inside], atol=2e-4)
    np.testing.assert_allclose(samples[0, inside, 3], seen.shade[0][inside], rtol=1e-6)


@pytest.mark.parametrize("axis", range(3))
def test_derivatives_by_the_card_s_place_are_those_of_small_steps(axis: int) -> None:
    pose = {"rotation_deg": [12, -25, 5], "translation_mm": [10, -5, 450]}
    of = world(items={"card": {"card_mm": [2000, 2000], "pose": pose}}, material={"reflectance": 0.7})
    held, step_mm = item_poses(of, "card")[0], 0.05
    pixels, views = (np.array([40, 120, 200]), np.array([60, 190, 330])), [SubpixelView((0.0, 0.0))]

    def scene(moved_mm: float) -> RenderScene:
        return build_scene(of, SceneState("card", held=held.moved(moved_mm * np.eye(3)[axis])))[0]

    motion = computed_motion(scene(0.0), views, pixels).motion[..., axis]
    before, after = (computed(scene(by), views, pixels=pixels).samples[0, 0] for by in (-step_mm, step_mm))
    slopes = (after - before) / (2 * step_mm)
    shade = 0.5 * (before + after)[:, 3]
    assert (shade > 0).all()
    np.testing.assert_allclose(motion[:, 0], slopes[:, 3] / shade, rtol=2e-3, atol=1e-6)
    np.testing.assert_allclose(motion[:, 3:], slopes[:, :2], rtol=2e-3, atol=2e-3)


def test_a_lens_is_straight_over_one_pixel() -> None:
    """With the strong distortion of a wide lens, against rays that are undistorted one by one."""
    camera = plain()["camera"] | {"sensor_size": SIZE, "pixel_um": 60.0, "focal_mm": 12.0}
    camera["distortion"] = [-0.25, 0.08, 1e-3, -1e-3, 0.0]
    pose = {"rotation_deg": [8, -5, 0], "translation_mm": [0, 0, 450]}
    of = world(camera=camera, items={"card": {"card_mm": [2000, 2000], "pose": pose}})
    scene = build_scene(of, SceneState("card"))[0]
    views = [SubpixelView(place) for place in ((0.5, 0.5), (-0.5, 0.5))]
    at_once = computed(scene, views).samples
    for view, table in zip(views, at_once, strict=True):
        shifted = scene.camera.matrix.copy()
        shifted[:2, 2] -= view.shift
        camera_of_view = replace(scene.camera, matrix=shifted)
        alone = computed(replace(scene, camera=camera_of_view), [SubpixelView((0.0, 0.0))]).samples[0]
        lit = (table[..., 3] > 0) & (alone[..., 3] > 0)
        assert lit.sum() > 1000
        # places of 2000 texels are rounded to 1e-4
        np.testing.assert_allclose(table[lit][:, :2], alone[lit][:, :2], atol=3e-4)


@pytest.mark.parametrize(("turned", "is_lit"), [(-75, True), (75, False)])
def test_a_card_between_camera_and_projector_is_dark(turned: float, is_lit: bool) -> None:
    """Its plane passes 120 mm beside the camera: to the left of it, or between it and the projector."""
    pose = {"rotation_deg": [0, turned, 0], "translation_mm": [0, 0, 450]}
    of = world(items={"card": {"card_mm": [100, 100], "pose": pose}})
    table = computed(build_scene(of, SceneState("card"))[0], [SubpixelView((0.0, 0.0))])
    assert table.albedo.max() == np.float32(0.9)
    assert bool(table.samples[..., 3].any()) is is_lit


def test_a_white_surface_that_faces_the_projector_has_irradiance_1() -> None:
    axis = world().T_projector_camera().inverse()
    pose = {
        "rotation_deg": np.degrees(axis.rotation_vector).tolist(),
        "translation_mm": axis.apply(np.array([0.0, -200.0, 475.0])).tolist(),
    }
    of = world(items={"card": {"card_mm": [100, 100], "pose": pose}}, material={"reflectance": 1.0})
    shade = computed(build_scene(of, SceneState("card"))[0], [SubpixelView((0.0, 0.0))]).samples[..., 3]
    np.testing.assert_allclose(shade[shade > 0], 1.0, rtol=1e-6)


@pytest.mark.parametrize("material", OTHER_MATERIALS)
def test_other_materials_are_left_to_blender(material: dict[str, Any]) -> None:
    assert not can_compute(build_scene(world(material=material), SceneState("card"))[0])


def test_bodies_are_left_to_blender() -> None:
    assert not can_compute(build_scene(world(), SceneState("pillars"))[0])
    assert can_compute(build_scene(world(), SceneState("card"))[0])
    assert can_compute(build_scene(world(), SceneState("board"))[0])
