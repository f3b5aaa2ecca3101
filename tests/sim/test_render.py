"""The picture that Blender makes, against the mathematics of camera, projector and light."""

from dataclasses import replace

import numpy as np
import pytest

from fpplab.core.conventions import Floats, Lattice, mirror_centres
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import Pattern, make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from sim.build import build_scene
from sim.light import Light, SceneState, ShownPattern
from sim.scene import RenderSettings, SubpixelView
from sim.worker import Blender
from tests.sim.conftest import card_points, grid, levels, seen, world

CARD, PILLARS = SceneState("card"), SceneState("pillars")


def test_camera_and_projector_agree_with_opencv(blender: Blender) -> None:
    """The projector coordinate painted on a plane is that of the analytic point, both lenses distorted."""
    for lattice in Lattice:
        of = world(projector={**_projector(), "lattice": lattice.value})
        samples = Light(of, blender).table(CARD).samples[0]
        points = card_points(of, grid(of))
        uv = of.projector_model().project(points, of.T_projector_camera())
        ones = np.ones((*uv.shape[:-1], 1))
        expected = np.concatenate([uv, ones], axis=-1) @ of.projector.texture().affine.T
        assert samples[..., 3].min() > 0.5
        # A camera pixel spans 9 texels here and its ray is good to 0.0005 px.
        assert np.abs(samples[..., :2] - expected).max() < 0.01
        assert np.abs(samples[..., :2] - expected).mean() < 0.002


def test_irradiance_follows_distance_and_angle(blender: Blender) -> None:
    """Every mirror gives the same flux, so irradiance is (D / r)² cos(incidence) / cos(axis)³."""
    of = world()
    shade = Light(of, blender).table(CARD).samples[0, ..., 3]
    points = of.T_projector_camera().apply(card_points(of, grid(of)))
    normal = of.T_projector_camera().rotation @ of.items["card"].pose.transform().rotation[:, 2]  # type: ignore[union-attr]
    distance = np.linalg.norm(points, axis=-1)
    cos_incidence = np.abs(points @ normal) / distance
    cos_axis = points[..., 2] / distance
    expected = 0.9 * (of.projector.distance_mm / distance) ** 2 * cos_incidence / cos_axis**3
    np.testing.assert_allclose(shade, expected, rtol=2e-5)


def test_surface_that_faces_the_white_projector_has_its_reflectance(blender: Blender) -> None:
    pose = world().T_projector_camera().inverse()
    facing = {
        "rotation_deg": np.degrees(pose.rotation_vector).tolist(),
        "translation_mm": pose.apply(np.array([0.0, -100.0, 475.0])).tolist(),
    }
    of = world(items={"card": {"card_mm": [300, 240], "pose": facing}}, material={"reflectance": 0.5})
    (white,) = seen(blender, of, CARD, *uniform_patterns([255], of.projector.size))
    np.testing.assert_allclose(white[60:70, 90:100], 0.5, rtol=1e-4)


@pytest.mark.parametrize("path", ["reference", "linear", "transport"])
def test_grey_ramp_is_a_straight_line(blender: Blender, path: str) -> None:
    """No tone curve, no sRGB: irradiance is proportional to the grey level, in every path."""
    of = world(render={"path": path, "subpixels": 1})
    greys = [0, 32, 64, 128, 255]
    pictures = seen(blender, of, CARD, *uniform_patterns(greys, of.projector.size))
    means = np.array([p[40:90, 60:130].mean() for p in pictures])
    np.testing.assert_allclose(means / means[-1], np.array(greys) / 255, atol=2e-6)


@pytest.mark.whole
def test_response_is_the_stated_one(blender: Blender) -> None:
    of = world(projector={**_projector(), "response": {"a": 0.9, "b": 0.05, "g": 1.8}})
    greys = [0, 100, 255]
    for path in ("transport", "linear", "reference"):
        chosen = of.model_copy(update={"render": of.render.model_copy(update={"path": path})})
        pictures = seen(blender, chosen, CARD, *uniform_patterns(greys, of.projector.size))
        means = np.array([p[40:90, 60:130].mean() for p in pictures])
        light = 0.9 * (np.array(greys) / 255) ** 1.8 + 0.05
        np.testing.assert_allclose(means / means[-1], light / light[-1], atol=2e-6)


@pytest.mark.whole
def test_changed_pattern_is_seen(blender: Blender) -> None:
    of = world(render={"path": "reference", "subpixels": 1})
    left = levels(lambda u, v: u < 456, of)
    right = levels(lambda u, v: u >= 456, of)
    first, second, again = seen(blender, of, CARD, left, right, left)
    assert np.abs(first - second).max() > 0.5
    assert (first + second).min() > 0.5
    np.testing.assert_array_equal(first, again)


@pytest.mark.parametrize("lattice", list(Lattice))
def test_single_mirrors_land_where_the_conventions_say(blender: Blender, lattice: Lattice) -> None:
    """One lit mirror at a time, sharp edged, on odd and even rows: the lit pixels look at its centre."""
    of = world(
        projector={**_projector(), "lattice": lattice.value, "blur": 0},
        render={"path": "reference", "subpixels": 1},
    )
    coordinate = of.projector_model().project(card_points(of, grid(of)), of.T_projector_camera())
    u, v = mirror_centres(of.projector.size, lattice)
    middle = np.median(coordinate, axis=(0, 1)).astype(int)
    lit = [(middle[1] + j, middle[0] + i) for j in range(-99, 100, 23) for i in range(-50, 51, 13)]
    image = np.zeros(u.shape, np.uint8)
    image[tuple(np.transpose(lit))] = 255
    (picture,) = seen(blender, of, CARD, Pattern("mirrors", image))
    nearest = np.min([_cells(coordinate, u[m], v[m], lattice) for m in lit], axis=0)
    # Half a cell; single precision moves a cell's edge by a hundredth at most.
    assert ((nearest < 0.49) == (picture > 0.1))[np.abs(nearest - 0.5) > 0.01].all()
    assert (picture > 0.1).sum() > 5


def _cells(coordinate: Floats, u: float, v: float, lattice: Lattice) -> Floats:
    """Distance from a mirror's centre such that its cell reaches to 0.5: a square, or one on its tip."""
    across, down = np.abs(coordinate[..., 0] - u), np.abs(coordinate[..., 1] - v)
    return np.asarray(across + down / 2 if lattice is Lattice.DIAMOND else np.maximum(across, down))


def test_shadows_are_dark(blender: Blender) -> None:
    """Some of the plate that the camera sees lies behind a pillar for the projector."""
    of = world()
    (white,) = seen(blender, of, PILLARS, *uniform_patterns([255], of.projector.size))
    middle = white[44:84, 56:136]
    assert (middle == 0).mean() > 0.01
    assert np.median(middle) > 0.5


def test_projector_light_ends_at_the_last_mirror(blender: Blender) -> None:
    """Moved far along the baseline, part of the card is outside the image and gets nothing."""
    of = world(stage={"travel_mm": [0, 400]})
    light = Light(of, blender)
    setup = SceneState("card", 0, 320.0)
    white = light.irradiance(setup, ShownPattern(tuple(uniform_patterns([255], of.projector.size)), 0))
    T = of.T_projector_camera(320.0)
    uv = of.projector_model().project(card_points(of, grid(of)), T)
    outside = (uv[..., 0] < -4) | (uv[..., 0] > 915) | (uv[..., 1] < -6) | (uv[..., 1] > 1145)
    inside = (uv[..., 0] > 4) & (uv[..., 0] < 907) & (uv[..., 1] > 6) & (uv[..., 1] < 1133)
    assert outside.any()
    assert inside.any()
    assert white[outside].max() < 1e-6  # the point-spread's last tail
    assert white[inside].min() > 0.1


def test_lens_model_does_not_fold_light_in_from_outside(blender: Blender) -> None:
    """Far off the axis a barrel distortion leads back into the image; no light goes there."""
    of = world(
        projector={**_projector(), "distortion": [-0.5, 0.0, 0.0, 0.0, 0.0]}, stage={"travel_mm": [0, 800]}
    )
    points = of.T_projector_camera(700.0).apply(card_points(of, grid(of)))
    uv = of.projector_model().project(points)
    folded = (uv >= 0).all(axis=-1) & (uv[..., 0] < 912) & (uv[..., 1] < 1140)
    assert folded.any(), "the case must be one that folds"
    show = ShownPattern(tuple(uniform_patterns([255], of.projector.size)), 0)
    assert Light(of, blender).irradiance(SceneState("card", 0, 700.0), show).max() == 0


@pytest.mark.whole
@pytest.mark.parametrize("blur", [0.0, 0.6])
def test_transport_and_linear_agree_with_reference(blender: Blender, blur: float) -> None:
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=1, steps=4), Sinusoid(axis="x", stripes=48, steps=4)))
    pictures = {}
    for path in ("reference", "linear", "transport"):
        of = world(projector={**_projector(), "blur": blur}, render={"path": path, "subpixels": 2})
        patterns = tuple(make_patterns(plan, of.projector.size, of.projector.lattice))
        light = Light(of, blender)
        pictures[path] = np.stack([light.irradiance(PILLARS, ShownPattern(patterns, i)) for i in (2, 5, 7)])
    transport = np.abs(pictures["transport"] - pictures["reference"])
    # Samples on the very edge of a sharp mirror may fall to either side; smooth optics have no edge.
    assert np.mean(transport > 1e-4) < (2e-3 if blur == 0 else 1e-5)
    linear = pictures["linear"] - pictures["reference"]
    assert np.abs(linear).max() < 1.2 / 255
    assert np.sqrt(np.mean(linear**2)) < 0.3 / 255
    assert pictures["reference"].max() > 0.5


@pytest.mark.nightly
def test_bounced_light_is_linear_too(blender: Blender) -> None:
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=6, steps=4),))
    pictures = {}
    for path, bounces in (("reference", 2), ("linear", 2), ("linear", 0)):
        of = world(render={"path": path, "subpixels": 1, "samples": 4, "bounces": bounces})
        patterns = tuple(make_patterns(plan, of.projector.size, of.projector.lattice))
        pictures[path, bounces] = Light(of, blender).irradiance(PILLARS, ShownPattern(patterns, 1))
    assert np.abs(pictures["linear", 2] - pictures["reference", 2]).max() < 2 / 255
    shadow = (pictures["linear", 0] == 0) & (np.abs(pictures["linear", 2]) > 0)
    assert shadow.sum() > 20, "interreflections must reach into shadows"


def test_picture_does_not_depend_on_the_window(blender: Blender) -> None:
    """Only the part of the image that holds the item is rendered; the whole image is the same."""
    of = world()
    scene, _ = build_scene(of, PILLARS)
    assert scene.window != (0, 0, *of.camera.size)
    views = [SubpixelView((0.0, 0.0))]
    part = blender.render(scene, None, views, RenderSettings(), 60).copy()
    whole = blender.render(replace(scene, window=(0, 0, *of.camera.size)), None, views, RenderSettings(), 60)
    np.testing.assert_array_equal(part, whole)


def test_item_out_of_sight_is_black(blender: Blender) -> None:
    away = {"rotation_deg": [180, 0, 0], "translation_mm": [2000, 0, 460]}
    of = world(items={"pillars": {"artefact": "pillars", "pose": away}})
    (white,) = seen(blender, of, PILLARS, *uniform_patterns([255], of.projector.size))
    assert white.max() == 0


def test_ambient_light_is_even_and_stays_when_the_projector_is_dark(blender: Blender) -> None:
    of = world(ambient=0.25)
    light = Light(of, blender)
    dark = light.irradiance(CARD, None)
    np.testing.assert_allclose(dark, 0.25 * 0.9, rtol=1e-5)
    (lit,) = seen(blender, of, CARD, *uniform_patterns([255], of.projector.size))
    (alone,) = seen(blender, world(), CARD, *uniform_patterns([255], of.projector.size))
    np.testing.assert_allclose(lit - dark, alone, atol=1e-6)


@pytest.mark.whole
def test_board_is_where_its_pose_says(blender: Blender) -> None:
    """The centres of the board's circles, seen under white light, are OpenCV's projection of its points."""
    import cv2

    from fpplab.targets import Target
    from sim.items import item_poses

    of = world(
        camera={
            "sensor_size": [480, 320],
            "pixel_um": 13132.8 / 480,
            "distortion": [-0.2, 0.3, 0.001, -0.002, 0.05],
            "binning": 1,
            "focal_mm": 35,
        }
    )
    (white,) = seen(blender, of, SceneState("board", 1), *uniform_patterns([255], of.projector.size))
    pose = item_poses(of, "board")[1]
    expected = of.camera_model().project(Target.load("target_paper.yaml").points(), pose)
    dark = ((white < 0.3) & (white > 1e-3)).astype(np.uint8)
    _, _, _, blobs = cv2.connectedComponentsWithStats(dark)
    distance = np.linalg.norm(blobs[1:, None] - expected[None], axis=-1).min(axis=0)
    # A circle covers about 40 pixels, so its centroid of whole pixels is good to a fraction of one.
    assert np.median(distance) < 0.15
    assert distance.max() < 0.6


def _projector() -> dict[str, object]:
    from tests.sim.conftest import plain

    return dict(plain()["projector"])
