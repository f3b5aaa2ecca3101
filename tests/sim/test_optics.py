"""Thin lenses of camera and projector, vignetting, mirrors and black level, against theory."""

from typing import Any

import numpy as np
import pytest
from scipy.special import j1

from fpplab.core.conventions import Floats
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import Pattern, make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from sim.light import Light, SceneState, ShownPattern
from sim.worker import Blender
from sim.world import World
from tests.sim.conftest import levels, plain, seen, world
from tests.sim.raycaster import Caster, Plane, Seen

CARD, PILLARS = SceneState("card"), SceneState("pillars")
COLUMNS, THROW, BLUR = 912, 1.2, 0.6
STRAIGHT = [0.0] * 5


def _with(section: str, **changes: Any) -> dict[str, Any]:
    """A section of the plain world with other fields."""
    return {**plain()[section], **changes}


def _card(size: tuple[float, float], at: Floats | list[float], turned: list[float] | None = None) -> Any:
    pose = {"rotation_deg": turned or [0, 0, 0], "translation_mm": np.asarray(at).tolist()}
    return {"card": {"card_mm": size, "pose": pose}}


def _white(of: World) -> tuple[Pattern, ...]:
    return tuple(uniform_patterns([255], of.projector.size))


def _seen_white(blender: Blender, of: World) -> Floats:
    return seen(blender, of, CARD, *_white(of))[0].astype(np.float64)


def _disc(circle: Floats, frequency: float) -> Floats:
    """Transfer of an even disc of that diameter: 2 J1(x) / x, x = π D f."""
    x = np.maximum(np.pi * np.abs(circle) * frequency, 1e-9)
    return np.asarray(2 * j1(x) / x)


# Depth of field of the camera: 682 px of focal length behind an aperture of 50 mm.
FOCAL_PX, APERTURE_MM, FOCUS_MM = 682.0, 50.0, 450.0


def _camera(focus_mm: float | None, distortion: list[float]) -> dict[str, Any]:
    return {
        "sensor_size": [256, 192],
        "binning": 1,
        "focal_mm": 35,
        "pixel_um": 35000 / FOCAL_PX,
        "f_number": 35 / APERTURE_MM,
        "focus_mm": focus_mm,
        "distortion": distortion,
    }


def _moments(picture: Floats, axis: int) -> tuple[float, float]:
    """Centroid and variance along an axis, px and px²."""
    profile = picture.sum(axis=1 - axis)
    place = np.arange(len(profile))
    middle = profile @ place / profile.sum()
    return float(middle), float(profile @ (place - middle) ** 2 / profile.sum())


@pytest.mark.nightly
@pytest.mark.parametrize(("depth", "axis"), [(340.0, 1), (385.0, 0), (412.0, 1), (495.0, 0), (560.0, 1)])
def test_depth_of_field_is_that_of_a_thin_lens(blender: Blender, depth: float, axis: int) -> None:
    """A strip's width: its own, the pixel's, and a disc of D = f_px A |1/z - 1/z_focus|, D²/16."""
    narrow, subpixels = 2.0, 8
    size = (60.0, narrow) if axis == 0 else (narrow, 60.0)
    of = world(
        camera=_camera(FOCUS_MM, STRAIGHT),
        items=_card(size, [0, 0, depth]),
        render={"subpixels": subpixels},
    )
    picture = _seen_white(blender, of)
    _, variance = _moments(picture, axis)
    own = (narrow * FOCAL_PX / depth) ** 2 / 12 + (1 - subpixels**-2) / 12
    circle = FOCAL_PX * APERTURE_MM * abs(1 / depth - 1 / FOCUS_MM)
    assert 6 < circle < 25
    assert 4 * np.sqrt(variance - own) == pytest.approx(circle, rel=0.03)
    # A disc ends, at its radius.
    lit = np.ptp(np.flatnonzero(picture.sum(axis=1 - axis) > 1e-9)) + 1
    assert lit == pytest.approx(narrow * FOCAL_PX / depth + circle, abs=2)


@pytest.mark.whole
def test_in_focus_the_picture_is_the_pinhole_s(blender: Blender) -> None:
    pictures = []
    for focus in (FOCUS_MM, None):
        of = world(
            camera=_camera(focus, [-0.2, 0.3, 0.001, -0.002, 0.05]),
            items=_card((300, 240), [0, 0, FOCUS_MM]),
            render={"subpixels": 2},
        )
        stripes = levels(lambda u, v: 0.5 + 0.5 * np.sin(u / 6) * np.sin(v / 9), of)
        pictures.append(seen(blender, of, CARD, stripes)[0])
    assert np.ptp(pictures[0]) > 0.5
    # Slopes of 0.08 a column and 2 columns a pixel; rays through the lens are good to 0.001 px.
    np.testing.assert_allclose(pictures[0], pictures[1], atol=2e-4)


@pytest.mark.nightly
def test_blur_does_not_move_a_dot(blender: Blender) -> None:
    """Both lenses distort, the dot is far from the axis, in front of focus and behind it."""
    for depth, x, y in ((395.0, 55.0, -38.0), (540.0, -70.0, 45.0)):
        middles, widths = [], []
        for focus in (None, FOCUS_MM):
            camera = _camera(focus, [-0.3, 0.3, 0.006, -0.008, 0.05])
            projector = _with("projector", distortion=[0.2, -0.1, 0.005, -0.004, 0.0])
            items = _card((8, 8), [x, y, depth])
            of = world(camera=camera, projector=projector, items=items, render={"subpixels": 6})
            picture = _seen_white(blender, of)
            moments = [_moments(picture, axis) for axis in (1, 0)]
            middles.append([m for m, _ in moments])
            widths.append([w for _, w in moments])
        circle = FOCAL_PX * APERTURE_MM * abs(1 / depth - 1 / FOCUS_MM)
        np.testing.assert_allclose(np.array(widths[1]) - widths[0], circle**2 / 16, rtol=0.15)
        # 5000 samples in a spot of 4 px RMS, spread evenly: not worse than 4 / √5000.
        np.testing.assert_allclose(middles[1], middles[0], atol=4 / np.sqrt(5000))
        expected = of.camera_model().project(np.array([x, y, depth]))
        np.testing.assert_allclose(middles[1], expected, atol=4 / np.sqrt(5000))


# Focus of the projector, on cards that face it: one depth, one circle of confusion.
SHARP_MM, LENS_MM = 475.0, 25.0


def _facing(depth: float, subpixels: int = 2, **projector: Any) -> World:
    """A large card perpendicular to the projector's axis, seen through a long lens: 4 pixels a column."""
    pose = world().T_projector_camera().inverse()
    turned = np.degrees(pose.rotation_vector).tolist()
    centre = pose.apply(np.array([0.0, -100.0, SHARP_MM]) * depth / SHARP_MM)
    camera = {"sensor_size": [360, 64], "binning": 1, "focal_mm": 35, "pixel_um": 8.55}
    # The lens shifts to the card's middle; turned, the camera would carry the projector along.
    camera["centre_offset_px"] = (-4093.6 * centre[:2] / centre[2]).tolist()
    return world(
        camera=camera,
        projector=_with("projector", distortion=STRAIGHT, **projector),
        items=_card((300, 300), centre, turned),
        render={"subpixels": subpixels},
    )


def _cast(of: World) -> Seen:
    """The card by the ray caster, with the same points of the pixels."""
    pose = of.items["card"].pose.transform()  # type: ignore[union-attr]
    lenses = of.camera_model(), of.projector_model(), of.T_projector_camera()
    caster = Caster(*lenses, of.projector.distance_mm, 0.9)
    return caster.look([Plane(pose.translation, -pose.rotation[:, 2])], of.render.subpixels)


def _circle(depth: Floats | float, aperture: float = LENS_MM) -> Any:
    """Diameter of the circle of confusion, in columns."""
    return THROW * COLUMNS * aperture * np.abs(1 / np.asarray(depth) - 1 / SHARP_MM)


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("depth", [390.0, 430.0, 475.0, 520.0, 590.0])
def test_projector_defocus_widens_an_edge(blender: Blender, depth: float) -> None:
    of = _facing(depth, focus_mm=SHARP_MM, aperture_mm=LENS_MM)
    u = _cast(of).u.mean(axis=0)
    edge = np.floor(np.median(u)) + 0.25  # half way between mirrors of even and odd rows
    lit, white = seen(blender, of, CARD, levels(lambda u, v: u < edge, of), *_white(of))
    share = lit.astype(np.float64) / white
    variance = float(np.mean(_variance(share, u - edge)))
    # A mirror's own width, in columns: √2 texels each; less what stepping by half columns adds to an edge.
    own = (BLUR**2 + 1 / 12) / 2 - 0.5**2 / 12
    # What the pixels add: points a quarter of one beside its middle, and straight lines between pixels.
    own += np.mean(np.diff(u, axis=1) ** 2) * (1 / 16 + 1 / 6)
    if depth == SHARP_MM:
        assert variance == pytest.approx(own, rel=0.01)
    else:
        assert 4 * np.sqrt(variance - own) == pytest.approx(float(_circle(depth)), rel=0.01)


def _variance(edge: Floats, place: Floats) -> Floats:
    """Of every row: how wide about 0 an edge is that falls from 1 to 0 in straight lines between places."""
    left, right = place[:, :-1], place[:, 1:]
    return np.asarray((-np.diff(edge, axis=1) * (left**2 + left * right + right**2) / 3).sum(axis=1))


def _modulation(blender: Blender, of: World, stripes: float) -> Floats:
    """Modulation of fringes where they should be, relative to white; negative for inverted ones."""
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=stripes, steps=4),))
    patterns = make_patterns(plan, of.projector.size, of.projector.lattice)
    a, b, c, d = (p.astype(np.float64) for p in seen(blender, of, CARD, *patterns))
    phase = 2 * np.pi * stripes * (_cast(of).u.mean(axis=0) + 0.5) / COLUMNS
    white = (a + b + c + d) / 2
    return np.asarray(((a - c) * np.cos(phase) + (b - d) * np.sin(phase)) / white)


def _lens(frequency: float) -> float:
    """Transfer of mirror and lens in focus, of a frequency per column."""
    return float(np.exp(-(np.pi**2) * (BLUR**2 + 1 / 12) * frequency**2))


@pytest.mark.whole_after(2)
@pytest.mark.parametrize("depth", [390.0, 450.0, 475.0, 590.0])
def test_defocused_fringes_fade_and_invert_as_a_disc_makes_them(blender: Blender, depth: float) -> None:
    of = _facing(depth, focus_mm=SHARP_MM, aperture_mm=LENS_MM)
    found, expected = [], []
    for stripes in (16, 64, 128):
        found.append(_modulation(blender, of, stripes).mean())
        frequency = stripes / COLUMNS
        expected.append(float(_disc(_circle(depth), frequency)) * _lens(frequency))
    np.testing.assert_allclose(found, expected, atol=0.01)
    if depth == 390:
        assert expected[2] < -0.1, "beyond its first zero a disc inverts"


@pytest.mark.nightly
@pytest.mark.parametrize(("axis", "stripes"), [("x", 80), ("y", 80)])
def test_defocus_follows_the_depth_across_a_tilted_card(blender: Blender, axis: Any, stripes: int) -> None:
    """Both sides of focus in one picture, in both directions of the diamond lattice, by both paths."""
    aperture, shown = 20.0, []
    for path in ("transport", "reference"):
        of = world(
            projector=_with("projector", focus_mm=SHARP_MM, aperture_mm=aperture),
            items=_card((250, 180), [0, 0, 462], [12, 25, 0]),
            render={"subpixels": 2, "path": path},
        )
        plan = Plan(fringes=(Sinusoid(axis=axis, stripes=stripes, steps=4),))
        pattern = make_patterns(plan, of.projector.size, of.projector.lattice)[1]
        shown.append(seen(blender, of, CARD, pattern)[0].astype(np.float64))
    frequency = stripes / (COLUMNS if axis == "x" else 1140 / 2)
    place = "u" if axis == "x" else "v"

    def light(u: Floats, v: Floats, depth: Floats) -> Floats:
        along = (u if place == "u" else v / 2) + (0.5 if place == "u" else 0.25)
        transfer = _disc(_circle(depth, aperture), frequency) * _lens(frequency)
        return np.asarray(0.5 + 0.5 * transfer * np.sin(2 * np.pi * frequency * along))

    cast = _cast(of)
    circles = _circle(cast.depth, aperture) * frequency
    assert circles.min() < 0.01
    assert circles.max() > 0.5
    assert np.abs(shown[0] - shown[1]).max() < 1e-4
    difference = shown[0] - cast.picture(light)
    # Between drawn circles, a factor of 1.3 apart, a mixture stands for the disc.
    assert np.abs(difference).max() < 0.02
    assert np.sqrt(np.mean(difference**2)) < 0.005


@pytest.mark.nightly
def test_paths_agree_on_defocus_across_pillars(blender: Blender) -> None:
    pictures = []
    for path in ("transport", "reference", "linear"):
        projector = _with("projector", focus_mm=450.0, aperture_mm=LENS_MM)
        of = world(projector=projector, render={"subpixels": 2, "path": path})
        plan = Plan(fringes=(Sinusoid(axis="x", stripes=48, steps=4),))
        patterns = make_patterns(plan, of.projector.size, of.projector.lattice)
        pictures.append(Light(of, blender).irradiance(PILLARS, ShownPattern(patterns, 1)).astype(np.float64))
    assert pictures[0].max() > 0.5
    assert np.abs(pictures[0] - pictures[1]).max() < 1e-4
    assert np.abs(pictures[2] - pictures[1]).max() < 1.2 / 255


@pytest.mark.whole
def test_defocus_does_not_move_a_spot_of_light(blender: Blender) -> None:
    middles = []
    for focus in (None, 430.0):
        projector = _with("projector", focus_mm=focus, aperture_mm=LENS_MM / 2)
        of = world(projector=projector, render={"subpixels": 3})
        u, v = np.median(_cast(of).u), np.median(_cast(of).v)
        spot = levels(lambda a, b, u=u, v=v: (np.abs(a - u) < 6) & (np.abs(b - v) < 12), of)
        (picture,) = seen(blender, of, CARD, spot)
        middles.append([_moments(picture.astype(np.float64), axis)[0] for axis in (1, 0)])
    np.testing.assert_allclose(middles[0], middles[1], atol=0.02)


@pytest.mark.parametrize("exponent", [1.5, 4.0])
def test_vignetting_is_a_power_of_the_cosine(blender: Blender, exponent: float) -> None:
    plainly = world(camera=_with("camera", focal_mm=16))
    with_loss = world(camera=_with("camera", focal_mm=16, vignetting=exponent))
    rays = _cast(plainly).points[0]
    whole, dimmed = _seen_white(blender, plainly), _seen_white(blender, with_loss)
    lit = whole > 0.2
    cosine = rays[..., 2] / np.linalg.norm(rays, axis=-1)
    assert cosine[lit].min() < 0.96
    np.testing.assert_allclose(dimmed[lit] / whole[lit], cosine[lit] ** exponent, rtol=1e-5)


def test_mirrors_fill_their_share(blender: Blender) -> None:
    """Through a long lens: dark between mirrors, brighter for it on them, and as much light altogether."""
    for fill in (1.0, 0.7, 0.5):
        of = _facing(SHARP_MM, subpixels=1, blur=0, fill_factor=fill)
        share = _seen_white(blender, of) / _cast(of).shade[0]
        lit = share > 0
        np.testing.assert_allclose(share[lit], 1 / fill, rtol=1e-4)
        # 2900 mirrors, of which each has 8 points: their share is good to a hundredth.
        assert lit.mean() == pytest.approx(fill, rel=0.01)


@pytest.mark.whole
def test_gaps_between_mirrors_are_the_same_by_both_paths(blender: Blender) -> None:
    pictures = []
    for path in ("transport", "reference"):
        of = world(
            projector=_with("projector", blur=0, fill_factor=0.7), render={"path": path, "subpixels": 2}
        )
        stripes = levels(lambda u, v: 0.5 + 0.5 * np.sin(u / 6), of)
        pictures.append(seen(blender, of, CARD, stripes)[0])
    # Samples on the very edge of a mirror may fall to either side.
    assert np.mean(np.abs(pictures[0] - pictures[1]) > 1e-4) < 2e-3
    assert pictures[0].max() > 0.5


@pytest.mark.whole
@pytest.mark.parametrize("path", ["transport", "reference"])
def test_contrast_is_that_of_the_black_level(blender: Blender, path: str) -> None:
    a, b = 0.95, 0.002
    of = world(
        projector=_with("projector", response={"a": a, "b": b, "g": 1.7}),
        render={"path": path, "subpixels": 1},
    )
    black, white = seen(blender, of, CARD, *uniform_patterns([0, 255], of.projector.size))
    np.testing.assert_allclose(white / black, (a + b) / b, rtol=1e-5)
    np.testing.assert_allclose(white, (a + b) * _cast(of).shade[0], rtol=2e-5)
