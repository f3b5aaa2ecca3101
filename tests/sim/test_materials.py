"""What surfaces are made of: Blender's pictures against the formulas of each material."""

import pickle
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.optimize import brentq

from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError
from fpplab.core.tagged_union import registered_types
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from sim.light import Light, SceneState, ShownPattern
from sim.worker import Blender
from sim.world import World, materials
from sim.world.materials import Material
from tests.sim.conftest import card_points, grid, levels, plain, seen, world

ROOT = Path(__file__).parents[2]
CARD, PILLARS = SceneState("card"), SceneState("pillars")
RIDGES = {"axis": [3.0, 4.0, 0.0], "period_mm": 20.0, "depth_mm": 3.0}
ROUGH = {"kind": "diffuse", "reflectance": 0.6, "roughness": 1.0}
GLOSSY = {"kind": "glossy", "reflectance": 0.6, "roughness": 0.5, "gloss": 0.1, "gloss_roughness": 0.4}
RIDGED = {**GLOSSY, "ridges": RIDGES, "grain": {"slope": 0.1, "size_mm": 3.0}}
DIRECT_KINDS = [ROUGH, GLOSSY, RIDGED]


class Lit(NamedTuple):
    """The card under white: radiance over irradiance of a facing surface, and unit vectors, all [v, u]."""

    ratio: Floats
    points: Floats
    normal: Floats
    to_light: Floats
    to_eye: Floats


def lit(blender: Blender, of: World, stage_mm: float = 0.0) -> Lit:
    """What the card reflects, freed of the projector's falloff with distance and angle."""
    shade = Light(of, blender).table(SceneState("card", 0, stage_mm)).samples[0, ..., 3].astype(np.float64)
    points = card_points(of, grid(of))
    seen_from = of.T_projector_camera(stage_mm)
    local = seen_from.apply(points)
    distance = np.linalg.norm(local, axis=-1)
    irradiance = (of.projector.distance_mm / distance) ** 2 / (local[..., 2] / distance) ** 3
    normal = -of.items["card"].pose.transform().rotation[:, 2]  # type: ignore[union-attr]
    light = seen_from.inverse().translation
    return Lit(shade / irradiance, points, normal, _unit(light - points), _unit(-points))


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def rough_diffuse(reflectance: float, roughness: float, at: Lit) -> Floats:
    """π f cos: Fujii's Oren-Nayar, and EON's light between facets with the reflectance to the third power."""
    cos_in, cos_out = at.to_light @ at.normal, at.to_eye @ at.normal
    a = 1 / (1 + (1 / 2 - 2 / (3 * np.pi)) * roughness)
    s = np.sum(at.to_light * at.to_eye, axis=-1) - cos_in * cos_out
    single = reflectance * a * (1 + roughness * s / np.where(s > 0, np.maximum(cos_in, cos_out), 1))
    mean = a * (1 + (2 / 3 - 28 / (15 * np.pi)) * roughness)
    left = (1 - _albedo(cos_in, a, roughness)) * (1 - _albedo(cos_out, a, roughness)) / max(1 - mean, 1e-12)
    return np.asarray((single + reflectance**3 * mean / (1 - reflectance * (1 - mean)) * left) * cos_in)


def _albedo(cosine: Floats, a: float, roughness: float) -> Floats:
    angle, sine = np.arccos(cosine), np.sqrt(1 - cosine**2)
    g = sine * (angle - sine * cosine) + 2 / 3 * (sine / cosine * (1 - sine**3) - sine)
    return np.asarray(a * (1 + roughness * g / np.pi))


def ggx(roughness: float, at: Lit) -> Floats:
    """π f cos of a white GGX reflector with Smith's height-correlated shadowing (Walter 2007, Heitz 2014)."""
    width = roughness**2
    half = _unit(at.to_light + at.to_eye)
    cos_in, cos_out, cos_half = (v @ at.normal for v in (at.to_light, at.to_eye, half))
    facets = width**2 / (np.pi * (cos_half**2 * (width**2 - 1) + 1) ** 2)
    hidden = [(np.sqrt(1 + width**2 * (1 / c**2 - 1)) - 1) / 2 for c in (cos_in, cos_out)]
    return np.asarray(np.pi * facets / (1 + hidden[0] + hidden[1]) / (4 * cos_out))


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("roughness", [0.0, 0.3, 1.0])
def test_rough_paint_is_oren_nayar(blender: Blender, roughness: float) -> None:
    at = lit(blender, world(material={**ROUGH, "roughness": roughness}))
    np.testing.assert_allclose(at.ratio, rough_diffuse(0.6, roughness, at), rtol=3e-5)


def test_gloss_is_ggx_over_the_body(blender: Blender) -> None:
    """The share of gloss replaces that share of the body; it is brightest about where the mirror would be."""
    of = world(material=GLOSSY)
    at = lit(blender, of)
    expected = 0.9 * rough_diffuse(0.6, 0.5, at) + 0.1 * ggx(0.4, at)
    np.testing.assert_allclose(at.ratio, expected, rtol=2e-4)
    gloss = at.ratio - 0.9 * rough_diffuse(0.6, 0.5, at)
    mirrored = _unit(at.to_light + at.to_eye) @ at.normal
    brightest = np.unravel_index(gloss.argmax(), gloss.shape)
    assert np.degrees(np.arccos(mirrored[brightest])) < 1.5
    assert gloss.max() > 10 * gloss.min()


@pytest.mark.parametrize("material", DIRECT_KINDS)
def test_one_sample_of_direct_light_is_free_of_noise(blender: Blender, material: dict[str, Any]) -> None:
    render = {"subpixels": 1, "cache": False}
    worlds = [world(material=material, seed=seed, render=render) for seed in (0, 1)]
    one, other = (Light(of, blender).table(PILLARS).samples for of in worlds)
    np.testing.assert_array_equal(one, other)
    assert one[..., 3].max() > 0.3


@pytest.mark.whole
@pytest.mark.parametrize("material", DIRECT_KINDS)
def test_transport_agrees_with_reference(blender: Blender, material: dict[str, Any]) -> None:
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=24, steps=4),))
    pictures = {}
    for path in ("transport", "reference"):
        of = world(material=material, render={"path": path, "subpixels": 1})
        patterns = make_patterns(plan, of.projector.size, of.projector.lattice)[1:3]
        pictures[path] = np.stack(seen(blender, of, PILLARS, *patterns))
    assert np.abs(pictures["transport"] - pictures["reference"]).max() < 1e-4
    assert pictures["reference"].max() > 0.3


def test_ridges_tilt_the_surface(blender: Blender) -> None:
    """Shading is the cosine to n - (g - n n·g), g the gradient of depth/2 sin(2π a·X / period)."""
    of = world(material={"reflectance": 0.6, "ridges": {**RIDGES, "depth_mm": 6.0}})
    at = lit(blender, of)
    pose = of.items["card"].pose.transform()  # type: ignore[union-attr]
    axis = np.array([0.6, 0.8, 0.0])
    phase = 2 * np.pi / 20.0 * (pose.inverse().apply(at.points) @ axis)
    gradient = (6.0 / 2 * 2 * np.pi / 20.0 * np.cos(phase))[..., None] * (pose.rotation @ axis)
    cosine = np.sum(_unit(at.normal - gradient) * at.to_light, axis=-1)
    assert cosine.min() > 0.2
    assert np.ptp(cosine) > 0.4
    np.testing.assert_allclose(at.ratio / 0.6, cosine, atol=1e-3)


def test_ridges_across_a_face_do_not_show_on_it(blender: Blender) -> None:
    """A gradient along the normal tilts nothing: layers show on walls, not on the top."""
    plain_card = lit(blender, world())
    layered = lit(blender, world(material={"ridges": {**RIDGES, "axis": [0.0, 0.0, 2.0]}}))
    np.testing.assert_allclose(layered.ratio, plain_card.ratio, rtol=1e-5)


def test_surface_under_ridges_stays_dark_where_it_faces_away(blender: Blender) -> None:
    """Tilted normals bring no light to the shadowed side: what is dark without them is dark with them."""
    bare, ridged = (
        Light(world(material=m), blender).table(PILLARS).samples[0, ..., 3] for m in (ROUGH, RIDGED)
    )
    assert (bare == 0).mean() > 0.01
    assert ridged[bare == 0].max() == 0


def gradients(blender: Blender, grain: dict[str, float]) -> Floats:
    """Gradients (pixels, 2) of a grained card along its x and y, from its shading under three lights."""
    ways = [([1.0, 0.0, 0.0], -80.0), ([0.0, 1.0, 0.0], 60.0), ([0.0, 1.0, 0.0], -60.0)]
    views = []
    for axis, position in ways:
        stage = {"axis": axis, "travel_mm": [-80, 80]}
        of = world(material={"reflectance": 1.0, "grain": grain}, stage=stage)
        views.append(lit(blender, of, position))
    lights = np.stack([at.to_light for at in views], axis=-2)
    ratios = np.stack([at.ratio for at in views], axis=-1)
    everywhere = ratios.min(axis=-1) > 0.2  # the whole white light of all three
    normals = np.linalg.solve(lights, ratios[..., None])[everywhere, :, 0]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, atol=1e-3)
    local = normals @ of.items["card"].pose.transform().rotation  # type: ignore[union-attr]
    return np.asarray(-local[:, :2] / local[:, 2:])


def test_grain_has_its_slope_in_every_direction(blender: Blender) -> None:
    """Facets of 2 mm are one or two pixels: some 10^4 of them, whose RMS is good to a percent."""
    g = gradients(blender, {"slope": 0.2, "size_mm": 2.0})
    assert len(g) > 10000
    assert np.sqrt(np.mean(np.sum(g**2, axis=-1))) == pytest.approx(0.2, rel=0.02)
    np.testing.assert_allclose(np.sqrt(np.mean(g**2, axis=0)), 0.2 / np.sqrt(2), rtol=0.03)
    np.testing.assert_allclose(g.mean(axis=0), 0.0, atol=0.005)


def test_facets_have_their_size(blender: Blender) -> None:
    """A facet has one normal, so their number is that of different normals.

    A window of area A and perimeter P meets A/s² + 2 P / (π s) + 1 cells of area s² and perimeter 4 s.
    """
    of, size = world(), 10.0
    g = gradients(blender, {"slope": 0.5, "size_mm": size})
    assert len(g) == of.camera.size[0] * of.camera.size[1]
    corners = card_points(of, grid(of))[[0, 0, -1, -1], [0, -1, -1, 0]]
    sides = np.roll(corners, -1, axis=0) - corners
    area = sum(np.linalg.norm(np.cross(sides[i], sides[i + 1])) for i in (0, 2)) / 2
    perimeter = np.linalg.norm(sides, axis=-1).sum()
    facets = len(np.unique(np.round(g, 2), axis=0))
    # As many as 1 in 25 share their rounded normal with another, or have one on the brink of rounding.
    assert facets == pytest.approx(area / size**2 + 2 * perimeter / (np.pi * size) + 1, rel=0.1)


def translucent(
    radius_mm: float, reflectance: float = 0.9, path: str = "reference", samples: int = 16
) -> World:
    """A card that light enters, and a projector without distortion."""
    return world(
        material={"kind": "translucent", "radius_mm": radius_mm, "reflectance": reflectance},
        projector={**plain()["projector"], "distortion": [0.0] * 5, "blur": 0},
        render={"path": path, "subpixels": 1, "samples": samples},
    )


def edge_profile(blender: Blender, radius_mm: float, at_radii: Floats) -> Floats:
    """Brightness over that under white, at distances from an edge of light, in mean free paths."""
    of = translucent(radius_mm, samples=8)
    size = of.projector.size
    half, white = seen(blender, of, CARD, levels(lambda u, v: u < 456, of), *uniform_patterns([255], size))
    points, T = card_points(of, grid(of)), of.T_projector_camera()
    projector = of.projector_model()
    # The plane of light between columns 455 and 456, on the diamond lattice a quarter of a column further.
    edge = T.rotation.T @ np.array([projector.matrix[0, 0], 0.0, projector.matrix[0, 2] - 455.75])
    offset = np.array([projector.matrix[0, 0], 0.0, projector.matrix[0, 2] - 455.75]) @ T.translation
    normal = of.items["card"].pose.transform().rotation[:, 2]  # type: ignore[union-attr]
    along = edge - normal * (normal @ edge)
    distance = -(points @ edge + offset) / np.linalg.norm(along) / radius_mm
    inside = white > 0.2
    share = half[inside] / white[inside].mean()
    bins = np.abs(distance[inside][None] - at_radii[:, None]) < 0.5
    return np.array([share[b].mean() / (white[inside][b].mean() / white[inside].mean()) for b in bins])


def walked(reflectance: float, at_radii: Floats, walks: int = 40000) -> Floats:
    """The same by a walk of isotropic scattering in a half-space, with entry as from matt paint."""
    random = np.random.default_rng(3)
    x, z = np.zeros(walks), np.zeros(walks)
    down = np.sqrt(random.uniform(size=walks))
    left, steps = [], []
    for step in range(400):
        side = np.sqrt(1 - down**2) * np.cos(2 * np.pi * random.uniform(size=len(x)))
        flight = random.exponential(size=len(x))
        out = z + flight * down < 0
        left.append((x - z * side / down)[out])
        steps.append(np.full(out.sum(), step))
        x, z = (x + flight * side)[~out], (z + flight * down)[~out]
        down = random.uniform(-1, 1, len(x))
    where, scatterings = np.concatenate(left), np.concatenate(steps)
    share = brentq(lambda a: (a**scatterings).sum() / walks - reflectance, 0.1, 1.0)
    weights = share**scatterings
    return np.array([weights[where < d].sum() / weights.sum() for d in at_radii])


@pytest.mark.nightly
def test_light_leaves_a_translucent_body_beside_where_it_entered(blender: Blender) -> None:
    """An edge of light is as soft, in mean free paths, as a walk of photons makes it, at any path length.

    Not closer, because half of Cycles' walks enter refracted, along the line of sight.
    """
    at_radii = np.array([-6.0, -3.0, -1.5, 0.0, 1.5, 3.0, 6.0])
    fine, coarse = (edge_profile(blender, radius, at_radii) for radius in (3.0, 6.0))
    expected = walked(0.9, at_radii)
    assert expected[0] > 0.03
    np.testing.assert_allclose(fine, coarse, atol=0.04)
    np.testing.assert_allclose(fine, expected, atol=0.06)
    np.testing.assert_allclose(coarse, expected, atol=0.06)


@pytest.mark.nightly
@pytest.mark.parametrize("reflectance", [0.5, 0.9])
def test_translucent_body_reflects_about_as_much_as_paint(blender: Blender, reflectance: float) -> None:
    """Light and eye are some 20° off the normal, where a body is up to 4 % brighter than from in front."""
    of = translucent(0.1, reflectance, samples=8)
    matt = of.model_copy(update={"material": world(material={"reflectance": reflectance}).material})
    white = uniform_patterns([255], of.projector.size)
    (soft,), (hard,) = seen(blender, of, CARD, *white), seen(blender, matt, CARD, *white)
    assert soft[hard > 0.2].sum() / hard[hard > 0.2].sum() == pytest.approx(1.0, abs=0.04)


@pytest.mark.whole
def test_linear_light_through_a_translucent_body(blender: Blender) -> None:
    """A basis gives what rendering every pattern gives, and `auto` chooses it."""
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=12, steps=4),))
    chosen = translucent(2.0, path="auto", samples=2)
    assert chosen.path == "linear"
    pictures = []
    for of in (chosen, translucent(2.0, samples=2)):
        patterns = tuple(make_patterns(plan, of.projector.size, of.projector.lattice))
        pictures.append(Light(of, blender).irradiance(CARD, ShownPattern(patterns, 1)))
    assert np.abs(pictures[0] - pictures[1]).max() < 3 / 255
    assert pictures[1].max() > 0.5


@pytest.mark.parametrize(("material", "total"), [(ROUGH, 0.6), (GLOSSY, 0.1 + 0.9 * 0.6)])
def test_ambient_light_meets_the_whole_reflectance(
    blender: Blender, material: dict[str, Any], total: float
) -> None:
    dark = Light(world(material=material, ambient=0.25), blender).irradiance(CARD, None)
    np.testing.assert_allclose(dark, 0.25 * total, rtol=1e-5)


def test_items_have_materials_of_their_own(blender: Blender) -> None:
    """Two cards in one place, one of a named material, one of the world's default material."""
    card = plain()["items"]["card"]
    of = world(
        items={"card": card, "black": {**card, "material": "soot"}},
        materials={"soot": {"reflectance": 0.09}},
    )
    white = uniform_patterns([255], of.projector.size)
    (bright,), (dark,) = seen(blender, of, CARD, *white), seen(blender, of, SceneState("black"), *white)
    np.testing.assert_allclose(dark, 0.1 * bright, rtol=1e-5)


def test_translucent_material_is_refused_where_light_is_direct() -> None:
    with pytest.raises(ConfigError, match=r"translucent material.*choose path auto, linear or reference"):
        translucent(1.0, path="transport")


def test_unknown_kind_is_refused_with_the_known_ones() -> None:
    known = ", ".join(registered_types(Material))
    with pytest.raises(ConfigError, match=f"must have a 'kind' of {known}"):
        world(material={"kind": "no such kind"})


def test_unknown_name_is_refused_with_the_known_ones() -> None:
    card = {**plain()["items"]["card"], "material": "wax"}
    with pytest.raises(ConfigError, match=r"'items.card.material' is 'wax'.*\(chalk, soot\)"):
        world(items={"card": card}, materials={"chalk": {}, "soot": {"reflectance": 0.05}})


@pytest.mark.parametrize(
    ("material", "field"),
    [
        ({"kind": "glossy", "gloss": 1.2}, "gloss"),
        ({"kind": "glossy", "gloss_roughness": 0.0}, "gloss_roughness"),
        ({"kind": "translucent", "radius_mm": 0.0}, "radius_mm"),
        ({"kind": "translucent", "gloss": 0.1}, "gloss"),
        ({"ridges": {"axis": [0, 0, 0]}}, "axis"),
        ({"grain": {"size_mm": 0}}, "size_mm"),
    ],
)
def test_values_that_cannot_be_are_refused(material: dict[str, Any], field: str) -> None:
    with pytest.raises(ConfigError, match=field):
        world(material=material)


def test_every_kind_of_material_is_found_and_drawn_by_a_shader_that_blender_has() -> None:
    """The modules of the package are the kinds; the shaders are a table in the code that runs in Blender."""
    kinds = registered_types(Material)
    modules = {module.name for module in iter_modules(materials.__path__)} - {"base", "relief"}
    assert list(kinds) == sorted(modules)
    shaders = (ROOT / "sim/blender/materials.py").read_text().partition("BASE_SHADERS = {")[2]
    for member in kinds.values():
        of = member()
        assert isinstance(of, Material)
        assert f'"{of.paint().base.shader}": BaseShader(' in shaders
        assert pickle.loads(pickle.dumps(of)) == of
