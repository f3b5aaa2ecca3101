"""The twin against the analytic ray caster, and both lenses against OpenCV, from what is rendered."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from fpplab.core.conventions import Axis, Floats, Lattice
from fpplab.core.geometry import Pinhole
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import Pattern, make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from sim.build import build_scene
from sim.light import Light, SceneState, ShownPattern
from sim.scene import DIRECT, RenderSettings, SubpixelView, X, Z
from sim.worker import Blender
from sim.world import World
from tests.sim.conftest import plain, samples_of_image, world
from tests.sim.raycaster import Box, Caster, Field, Plane, Seen, Shape, Sphere

RADIUS, ACROSS, BLUR = 40.0, 2, 0.6
REFLECTANCE, DISTANCE_MM = 0.9, 475.0
BOXES = (((-45, -35, -5), (45, 35, 5)), ((-40, -30, -1), (5, 30, 20)))
RAY_PX = 1e-3
"""How well the camera's rays are known: Cycles draws the sample within a hundredth of a pixel."""


@dataclass(frozen=True)
class Bench:
    """The same scene by Blender and by the ray caster.

    facets: greatest distance of the mesh's surface from the shape, in mm, and angle between their normals, in
    rad.
    """

    world: World
    setup: SceneState
    seen: Seen
    further: Seen | None = None
    facets: tuple[float, float] = (0.0, 0.0)

    def difference(self, picture: np.ndarray[Any, Any], light: Field) -> Floats:
        """Twin minus ray caster away from edges, (n,)."""
        return np.asarray((picture - self.seen.picture(light))[self.seen.smooth])


@pytest.fixture(scope="module", params=["step", "card", "ball"])
def bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Bench:
    folder, name = tmp_path_factory.mktemp("parts"), request.param
    of = world(items={**plain()["items"], **_parts(folder)}, render={"subpixels": ACROSS})
    pose = of.items[name].pose.transform()  # type: ignore[union-attr]
    lenses = of.camera_model(), of.projector_model(), of.T_projector_camera()
    caster = Caster(*lenses, DISTANCE_MM, REFLECTANCE)
    if name == "ball":
        ball = Sphere(pose.translation, RADIUS)
        facet = trimesh.load_mesh(folder / "ball.stl").edges_unique_length.max() / np.sqrt(3)
        sag = facet**2 / (2 * RADIUS)
        inner = caster.look([Sphere(pose.translation, RADIUS - sag)], ACROSS)
        return Bench(of, SceneState(name), caster.look([ball], ACROSS), inner, (sag, facet / RADIUS))
    shapes: list[Shape] = [Plane(pose.translation, -pose.rotation[:, 2])]
    if name == "step":
        shapes = [Box(np.array(low, float), np.array(high, float), pose) for low, high in BOXES]
    return Bench(of, SceneState(name), caster.look(shapes, ACROSS))


def _parts(folder: Path) -> dict[str, Any]:
    trimesh.creation.icosphere(subdivisions=6, radius=RADIUS).export(folder / "ball.stl")
    boxes = [trimesh.creation.box(bounds=bounds) for bounds in BOXES]
    trimesh.util.concatenate(boxes).export(folder / "step.stl")  # type: ignore[no-untyped-call]
    ball = {"rotation_deg": [0, 0, 0], "translation_mm": [3, -2, 470]}
    step = {"rotation_deg": [170, 8, 5], "translation_mm": [2, 1, 465]}
    return {
        "ball": {"mesh": str(folder / "ball.stl"), "pose": ball},
        "step": {"mesh": str(folder / "step.stl"), "pose": step},
    }


def _shown(blender: Blender, of: World, setup: SceneState, patterns: tuple[Pattern, ...]) -> list[Floats]:
    light = Light(of, blender)
    return [
        light.irradiance(setup, ShownPattern(patterns, i)).astype(np.float64, copy=True)
        for i in range(len(patterns))
    ]


def test_the_case_has_shadows_edges_and_enough_to_compare(bench: Bench) -> None:
    seen, name = bench.seen, bench.setup.item
    assert seen.smooth.sum() > 5000
    dark = (seen.shade == 0) & (seen.points[..., 2] > 0)
    assert (dark.sum() > 300) == (name != "card")


@pytest.mark.whole
@pytest.mark.parametrize("path", ["transport", "reference"])
def test_irradiance_under_white(blender: Blender, bench: Bench, path: str) -> None:
    of = _on(bench.world, path)
    (white,) = _shown(blender, of, bench.setup, tuple(uniform_patterns([255], of.projector.size)))
    difference = bench.difference(white, _evenly)
    brightest = bench.seen.shade.max()
    tilt = bench.facets[1]
    assert np.abs(difference).max() < 1e-5 + tilt * brightest
    # In an equilateral facet the normals' error along one direction has 0.36 of its greatest.
    assert np.sqrt(np.mean(difference**2)) < 5e-6 + 0.36 * tilt * brightest


@pytest.mark.whole_after(1)
def test_edges_and_shadows_lie_where_they_should(blender: Blender, bench: Bench) -> None:
    """Hardly a sample is illuminated in one and dark in the other, edges included."""
    lit = samples_of_image(Light(bench.world, blender).table(bench.setup))[..., 3] > 0
    wrong = lit != (bench.seen.shade > 0)
    # An edge of a ball of facets is out by the facets' sag, and its terminator by their tilt.
    assert wrong.mean() < (3e-4 if bench.further else 2e-5)


@pytest.mark.whole
def test_projector_coordinates_in_the_table(blender: Blender, bench: Bench) -> None:
    of, seen = bench.world, bench.seen
    affine = of.projector.texture().affine
    texels = samples_of_image(Light(of, blender).table(bench.setup))[..., :2]
    u, v = np.moveaxis((texels - affine[:, 2]) @ np.linalg.inv(affine[:, :2]).T, -1, 0)
    for found, name in ((u, "u"), (v, "v")):
        expected = getattr(seen, name)
        error = np.abs(found - expected)[:, seen.smooth]
        # Pixels are 2 columns and 4 rows apart here; facets lie between the ball and one less their sag.
        allowed = np.abs(np.gradient(expected, axis=(1, 2))).max(axis=0) * RAY_PX * 2
        if bench.further:
            allowed = allowed + 1.2 * np.abs(getattr(bench.further, name) - expected)
        assert (error < allowed[:, seen.smooth]).all()


@pytest.mark.whole
@pytest.mark.parametrize(
    ("axis", "stripes", "path"),
    [("x", 8, "transport"), ("x", 48, "transport"), ("x", 48, "reference"), ("y", 48, "transport")],
)
def test_fringes(blender: Blender, bench: Bench, axis: Axis, stripes: int, path: str) -> None:
    of = _on(bench.world, path)
    plan = Plan(fringes=(Sinusoid(axis=axis, stripes=stripes, steps=4),))
    patterns = make_patterns(plan, of.projector.size, of.projector.lattice)[:2]
    frequency = stripes / (912 if axis == "x" else 1140)
    # Rows of the diamond lattice are half a column apart, its texels a column over the root of 2.
    per_texel = frequency * (1 if axis == "x" else 2) / np.sqrt(2)
    transfer = np.exp(-2 * np.pi**2 * (BLUR**2 + 1 / 12) * per_texel**2)
    # Interpolation along both texel axes, at 45 degrees to the fringes, leaves four ripples between texels.
    ripple = 0.5 * (1 - np.sinc(per_texel / np.sqrt(2)) ** 4)
    brightest = bench.seen.shade.max()
    greatest = (ripple + 0.5 / 255) * brightest + bench.facets[1] * brightest
    rms = np.hypot(ripple / np.sqrt(8), 1 / 255 / np.sqrt(12)) * brightest + 0.36 * bench.facets[1]
    for n, picture in enumerate(_shown(blender, of, bench.setup, patterns)):
        difference = bench.difference(picture, _fringe(axis, frequency, transfer, np.pi / 2 * n))
        assert np.abs(difference).max() < greatest
        assert np.sqrt(np.mean(difference**2)) < rms
        inverted = bench.difference(picture, _fringe(axis, frequency, -transfer, np.pi / 2 * n))
        assert np.sqrt(np.mean(inverted**2)) > 0.2, "it must be the fringes that are compared"


def _evenly(u: Floats, v: Floats, depth: Floats) -> Floats:
    return np.ones_like(u)


def _fringe(axis: Axis, frequency: float, transfer: float, shift: float) -> Callable[..., Floats]:
    def light(u: Floats, v: Floats, depth: Floats) -> Floats:
        phase = 2 * np.pi * frequency * ((u if axis == "x" else v) + 0.5) - shift
        return np.asarray(0.5 + 0.5 * transfer * np.cos(phase))

    return light


def _on(of: World, path: str) -> World:
    return of.model_copy(update={"render": of.render.model_copy(update={"path": path})})


LARGE = (1368, 912)
CAMERA = [-0.45, 0.4, 0.02, -0.015, 0.1]
PROJECTOR = [0.3, -0.2, -0.008, 0.01, 0.05]
RATIONAL = [0.5, 0.1, 0.01, -0.008, 0.02, 0.9, 0.3, 0.05]


def _distorting(lattice: Lattice, lens: list[float] = PROJECTOR) -> World:
    """Both lenses strongly distorted, the camera with as many pixels as on a real bench."""
    camera = {**plain()["camera"], "sensor_size": LARGE, "pixel_um": 13132.8 / LARGE[0], "distortion": CAMERA}
    projector = {**plain()["projector"], "distortion": lens, "lattice": lattice.value}
    return world(camera=camera, projector=projector)


def _project(model: Pinhole, points: Floats, rotation: Floats, translation: Floats) -> Floats:
    vector, _ = cv2.Rodrigues(rotation)
    pixels, _ = cv2.projectPoints(
        np.ascontiguousarray(points).reshape(-1, 3),
        vector,
        translation,
        model.matrix,
        np.array(model.distortion),
    )
    return np.asarray(pixels.reshape(*points.shape[:-1], 2))


def _pixel_error(of: World, points: Floats, shift: tuple[float, float]) -> Floats:
    """How far from where pixels look OpenCV projects the points that they saw, (..., 2) in px.

    Of a large picture it is every other pixel.
    """
    width, height = of.camera.size
    step = width // points.shape[1]
    v, u = np.mgrid[0:height:step, 0:width:step]
    pixels = _project(of.camera_model(), points, np.eye(3), np.zeros(3))
    return np.asarray(pixels - np.stack([u, v], axis=-1) - shift)


@pytest.mark.nightly
def test_points_seen_beside_a_pixel_s_middle_project_there(blender: Blender) -> None:
    of, shift = _distorting(Lattice.DIAMOND), (0.25, -0.375)
    scene, _ = build_scene(of, SceneState("card"))
    seen = blender.render(scene, None, [SubpixelView(shift)], RenderSettings(survey=True), 60)
    points = seen[0, ::2, ::2, X : Z + 1].astype(np.float64)
    model = of.camera_model()
    straight = Pinhole(model.size, model.matrix)
    bent = _project(straight, points, np.eye(3), np.zeros(3)) - model.project(points)
    assert np.abs(bent).max() > 20, "the lens must distort"
    assert np.abs(_pixel_error(of, points, shift)).max() < 0.002


@pytest.mark.parametrize("distortion", [CAMERA, [0.5, 0.5, 0.02, 0.02, 0.5], RATIONAL])
def test_points_seen_through_a_wide_lens_project_to_their_pixels(
    blender: Blender, distortion: list[float]
) -> None:
    """90 degrees across, where it takes more than a few steps of a fixed point to invert the distortion."""
    camera = {**plain()["camera"], "focal_mm": 8, "distortion": distortion}
    pose = {"rotation_deg": [3, -5, 0], "translation_mm": [0, 0, 450]}
    of = world(camera=camera, items={"card": {"card_mm": [4000, 4000], "pose": pose}})
    scene, _ = build_scene(of, SceneState("card"))
    rendered = blender.render(scene, None, [SubpixelView((0.0, 0.0))], RenderSettings(survey=True), 60)
    points = rendered[0, ..., X : Z + 1].astype(np.float64)
    assert points[..., 2].min() > 100
    assert np.abs(_pixel_error(of, points, (0.0, 0.0))).max() < 0.002


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("lens", "lattice"),
    [
        pytest.param(PROJECTOR, Lattice.DIAMOND, id="five-diamond"),
        pytest.param(RATIONAL, Lattice.SQUARE, id="eight-square", marks=pytest.mark.nightly),
        pytest.param(PROJECTOR, Lattice.SQUARE, id="five-square", marks=pytest.mark.nightly),
        pytest.param(RATIONAL, Lattice.DIAMOND, id="eight-diamond", marks=pytest.mark.nightly),
    ],
)
def test_light_comes_from_the_mirrors_that_points_project_to(
    blender: Blender, lattice: Lattice, lens: list[float]
) -> None:
    """A lamp whose first colour is white and whose others grow with the texture's column and row tells by
    its light which mirror each point is lit by; the table of direct light must say the same."""
    of = _distorting(lattice, lens)
    scene, texture = build_scene(of, SceneState("card"))
    rows, columns = scene.lamp.texture_shape
    row, column = np.mgrid[0:rows, 0:columns] / (texture.places_per_mirror * max(texture.shape))
    ramps = np.stack([np.ones((rows, columns)), column, row], axis=-1).astype(np.float32)[None]
    rendered = blender.render(scene, ramps, [SubpixelView((0.0, 0.0))], RenderSettings(survey=True), 60)[
        0, ::2, ::2
    ].astype(np.float64)
    pose = of.T_projector_camera()
    points = rendered[..., X : Z + 1]
    assert np.abs(_pixel_error(of, points, (0.0, 0.0))).max() < 0.002
    expected = _project(of.projector_model(), points, pose.rotation, pose.translation)
    inside = (expected > 2).all(axis=-1) & (expected < np.array([909, 1137])).all(axis=-1)
    lit = inside & (rendered[..., DIRECT] > 0.1)
    assert lit.sum() > 0.5 * lit.size
    by_light = rendered[lit][:, 1:3] / rendered[lit][:, :1] * max(texture.shape)
    by_table = samples_of_image(Light(of, blender).table(SceneState("card")))[0, ::2, ::2][lit][:, :2]
    square, offset = texture.affine[:, :2], texture.affine[:, 2]
    for texels in (by_light, by_table.astype(np.float64)):
        found = (texels - offset) @ np.linalg.inv(square).T
        assert np.abs(found - expected[lit]).max() < 0.002
