"""Effects of the twin through its devices: vibration, shutters, colours, indirect light."""

import logging
import math
from typing import Any

import numpy as np
import pytest
import trimesh
from manifold3d import CrossSection, Manifold

from fpplab.artefacts import save_stl
from fpplab.core.conventions import TWO_PI, Floats, Image
from fpplab.devices import CameraSettings
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from fpplab.phase import wrapped_phase
from sim.light import Light, SceneState, ShownPattern
from sim.sensor import photopic_efficiency
from sim.worker import Blender
from sim.world import World
from tests.sim.conftest import Bench, card_points, grid, plain, world

EXPOSURE_S = 0.02
BLACK = 0.01 * 4095
BRIGHT, QUIET = 1e4, {"full_well_e": 1e9, "read_noise_e": 0.0}
"""Lumens and a sensor for which shot noise is 0.003 % of full scale."""


def stand(bench: Bench, exposure_s: float = EXPOSURE_S, gain_db: float = 0.0, **changes: Any) -> World:
    """Give the virtual bench that world with its card mounted, and count frames from 0."""
    of = world(**changes)
    bench.shared.replace_world(of)
    bench.fixture.mount("card")
    bench.camera.close()
    bench.camera.open()
    bench.camera.configure(CameraSettings(exposure_s, gain_db, 12))
    return of


def projector(**fields: Any) -> dict[str, Any]:
    return {**plain()["projector"], **fields}


def quiet(**changes: Any) -> dict[str, Any]:
    """A bench with hardly any noise."""
    lamp: dict[str, Any] = {
        "leds": {"green": {"lumens": BRIGHT, "wavelength_nm": 525}},
        **changes.pop("projector", {}),
    }
    eye = {**plain()["camera"], "sensor": QUIET, **changes.pop("camera", {})}
    return {"projector": projector(**lamp), "camera": eye, **changes}


def fringe(steps: int, stripes: float = 16) -> Sinusoid:
    return Sinusoid(axis="x", stripes=stripes, steps=steps)


def taken(bench: Bench, of: World, fringes: Sinusoid) -> list[Image]:
    """A frame of every step."""
    plan = Plan(fringes=(fringes,))
    bench.projector.load(make_patterns(plan, of.projector.size, of.projector.lattice))
    frames = []
    for i in range(fringes.steps):
        bench.projector.show(i)
        frames.append(bench.camera.snap().image)
    return frames


def phase(frames: list[Image], fringes: Sinusoid) -> Floats:
    return wrapped_phase(frames, fringes).phase.astype(np.float64)


def turned(difference: Floats) -> Floats:
    """Differences of phase within half a turn."""
    return np.asarray((difference + np.pi) % TWO_PI - np.pi)


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


# Vibration -------------------------------------------------------------------------------------------


def phase_per_mm(of: World, stripes: float) -> tuple[Floats, Floats]:
    """How the fringes' phase at each pixel follows the card along its normal, rad/mm; and that normal.

    A pixel goes on looking along its ray d, on which the card's point moves by (n·s)/(n·d) d.
    """
    points = card_points(of, grid(of))
    rays = points / points[..., 2:]
    normal = of.items["card"].pose.transform().rotation[:, 2]  # type: ignore[union-attr]
    pose, device = of.T_projector_camera(), of.projector_model()
    step = 1e-3
    ahead, here = (device.project(pose.apply(p))[..., 0] for p in (points + step * rays, points))
    per_mm_of_ray = (ahead - here) / step
    return TWO_PI * stripes / of.projector.size[0] * per_mm_of_ray / (rays @ normal), normal


def shake(seed: int, frame: int, vibration_mm: float) -> Floats:
    """Where the item is during a frame, as `VirtualBench.irradiance` documents."""
    return vibration_mm * np.random.default_rng([seed, frame]).standard_normal(3)


@pytest.mark.parametrize("steps", [3, 4])
def test_phase_errors_of_vibration_are_those_of_theory(bench: Bench, steps: int) -> None:
    """To first order an error e_n of the phase in frame n makes `(2/N) Σ sin²(φ - δ_n) e_n` of it."""
    vibration, fringes = 0.2, fringe(steps)
    of = stand(bench, **quiet())
    still = phase(taken(bench, of, fringes), fringes)
    stand(bench, **quiet(vibration_mm=vibration))
    error = turned(phase(taken(bench, of, fringes), fringes) - still)
    per_mm, normal = phase_per_mm(of, fringes.stripes)
    expected = np.zeros_like(error)
    for n in range(steps):
        moved = per_mm * (normal @ shake(of.seed, n, vibration))
        expected += 2 / steps * np.sin(still - TWO_PI * n / steps) ** 2 * moved
    assert rms(expected) > 0.005
    assert rms(error - expected) < 0.15 * rms(expected)


@pytest.mark.whole
def test_phase_errors_grow_with_the_vibration(bench: Bench) -> None:
    """The same seed gives the same vibration, so that errors are in proportion."""
    fringes = fringe(4)
    of = stand(bench, **quiet())
    still = phase(taken(bench, of, fringes), fringes)
    found = []
    for vibration in (0.1, 0.2, 0.4):
        stand(bench, **quiet(vibration_mm=vibration))
        found.append(rms(turned(phase(taken(bench, of, fringes), fringes) - still)) / vibration)
    assert found[0] > 0.02
    np.testing.assert_allclose(found, found[0], rtol=0.08)


def test_vibration_has_its_standard_deviation(bench: Bench) -> None:
    """Over many measurements the error's mean square is 3/(2N) times that of one frame's phase.

    16 measurements of 3 frames have some 32 independent errors: their RMS is good to 13 %.
    """
    vibration, steps, times = 0.2, 3, 16
    fringes = fringe(steps)
    small = {"sensor_size": [48, 32], "pixel_um": 13132.8 / 48}
    lamp: dict[str, Any] = {"leds": {"green": {"lumens": BRIGHT / 16, "wavelength_nm": 525}}}
    lamp |= {"size": [228, 285], "centre_px": [113.5, 277.0]}  # fewer mirrors to draw
    of = stand(bench, **quiet(camera=small, projector=lamp))
    still = phase(taken(bench, of, fringes), fringes)
    of = stand(bench, **quiet(camera=small, projector=lamp, vibration_mm=vibration))
    errors = [turned(phase(taken(bench, of, fringes), fringes) - still) for _ in range(times)]
    per_mm, _ = phase_per_mm(of, fringes.stripes)
    expected = math.sqrt(3 / (2 * steps)) * vibration * rms(per_mm)
    assert rms(np.stack(errors)) == pytest.approx(expected, rel=0.2)


def test_without_vibration_frames_differ_by_their_noise_alone(bench: Bench) -> None:
    of = stand(bench)
    bench.projector.load(uniform_patterns([200], of.projector.size))
    bench.projector.show(0)
    first, second = (bench.shared.irradiance(CameraSettings(EXPOSURE_S), n) for n in range(2))
    np.testing.assert_array_equal(first, second)


def test_every_frame_has_its_own_reproducible_vibration(bench: Bench) -> None:
    def run(seed: int) -> list[Image]:
        of = stand(bench, seed=seed, vibration_mm=0.5)
        bench.projector.load(
            make_patterns(Plan(fringes=(fringe(3, 64),)), of.projector.size, of.projector.lattice)
        )
        bench.projector.show(0)
        return [bench.camera.snap().image for _ in range(2)]

    first, again, other = run(3), run(3), run(4)
    np.testing.assert_array_equal(first, again)
    noise = math.sqrt(2) * 30  # of two frames, at full well in grey levels
    assert rms(first[0].astype(float) - first[1]) > 3 * noise
    assert rms(first[0].astype(float) - other[0]) > 3 * noise


# The shutter against the mirrors ---------------------------------------------------------------------

PERIOD_S = 1 / 120
ROWS_A_PERIOD = 32
ROLLING = {"shutter": {"line_time_s": PERIOD_S / ROWS_A_PERIOD}}
MIRRORS = {"period_s": PERIOD_S}


def share_of_steady(bench: Bench, grey: int, exposure_s: float, shutter: dict[str, Any]) -> Floats:
    """Irradiance of one grey level relative to steady light, (height, width)."""
    pictures = []
    for mirrors in (MIRRORS, {}):
        of = stand(bench, exposure_s, **quiet(camera=shutter, projector=mirrors))
        bench.projector.load(uniform_patterns([grey], of.projector.size))
        bench.projector.show(0)
        pictures.append(bench.shared.irradiance(CameraSettings(exposure_s), 5).astype(np.float64))
    assert pictures[1].min() > 0.05
    return np.asarray(pictures[0] / pictures[1])


@pytest.mark.parametrize("grey", [60, 128, 255])
@pytest.mark.parametrize("shutter", [ROLLING, {}], ids=["rolling", "global"])
@pytest.mark.parametrize("periods", [1, 7])
def test_whole_periods_are_steady_light(
    bench: Bench, periods: int, shutter: dict[str, Any], grey: int
) -> None:
    share = share_of_steady(bench, grey, periods * PERIOD_S, shutter)
    np.testing.assert_allclose(share, 1.0, atol=1e-5)


def test_nearly_whole_periods_are_nearly_steady_light(bench: Bench) -> None:
    """The sum of the binary planes is the pattern: no jump where planes begin to be weighted separately."""
    share = share_of_steady(bench, 100, 2 * PERIOD_S * (1 + 1e-7), ROLLING)
    np.testing.assert_allclose(share, 1.0, atol=1e-5)


def test_exposures_of_fractional_periods_make_bands_that_repeat_with_the_mirrors(bench: Bench) -> None:
    share = share_of_steady(bench, 128, 1.5 * PERIOD_S, ROLLING)
    assert np.ptp(share, axis=1).max() < 1e-5, "a band is a whole row"
    rows = share.mean(axis=1)
    np.testing.assert_allclose(rows[ROWS_A_PERIOD:], rows[:-ROWS_A_PERIOD], atol=1e-5)
    # The brightest plane alone is on, for 128/255 of a period. The half period beside the whole one meets it
    # wholly at best, and for 1/255 at worst; rows come by at every 32nd of a period.
    on = 128 / 255
    least, most = ((on + half) / (1.5 * on) for half in (1 / 510, 0.5))
    between = 1 / ROWS_A_PERIOD / (1.5 * on)
    assert most - between < rows.max() < most + 1e-5
    assert least - 1e-5 < rows.min() < least + between
    spectrum = np.abs(np.fft.rfft(rows - rows.mean()))
    assert np.argmax(spectrum) == len(rows) // ROWS_A_PERIOD


@pytest.mark.parametrize("shutter", [ROLLING, {}], ids=["rolling", "global"])
@pytest.mark.parametrize("periods", [0.3, 1.5, 2.75])
def test_white_has_no_bands(bench: Bench, periods: float, shutter: dict[str, Any]) -> None:
    np.testing.assert_allclose(share_of_steady(bench, 255, periods * PERIOD_S, shutter), 1.0, atol=1e-5)


def test_a_global_shutter_gets_a_wrong_level_but_no_rows(bench: Bench) -> None:
    share = share_of_steady(bench, 128, 1.5 * PERIOD_S, {})
    assert np.ptp(share) < 1e-5
    assert abs(share.mean() - 1) > 0.05


@pytest.mark.parametrize("shutter", [ROLLING, {}], ids=["rolling", "global"])
def test_fractional_periods_disturb_the_phase_and_whole_ones_do_not(
    bench: Bench, shutter: dict[str, Any]
) -> None:
    fringes = fringe(4)

    def found(periods: float, mirrors: dict[str, Any]) -> Floats:
        lumens = {
            "leds": {"green": {"lumens": BRIGHT * EXPOSURE_S / PERIOD_S / periods, "wavelength_nm": 525}}
        }
        of = stand(bench, periods * PERIOD_S, **quiet(camera=shutter, projector={**mirrors, **lumens}))
        return phase(taken(bench, of, fringes), fringes)

    steady = found(2, {})
    assert rms(turned(found(2, MIRRORS) - steady)) < 1e-3
    assert rms(turned(found(1.5, MIRRORS) - steady)) > 0.015


# From lumens to grey levels --------------------------------------------------------------------------


def facing(**changes: Any) -> dict[str, Any]:
    """A card of reflectance 0.5 that faces the projector where its irradiance is that of the chain."""
    pose = world().T_projector_camera().inverse()
    card = {
        "card_mm": [300, 240],
        "pose": {
            "rotation_deg": np.degrees(pose.rotation_vector).tolist(),
            "translation_mm": pose.apply(np.array([0.0, -100.0, 475.0])).tolist(),
        },
    }
    return {"items": {"card": card}, "material": {"reflectance": 0.5}, **changes}


def grey_level(bench: Bench) -> float:
    """Of white in the middle of the card, above black."""
    bench.projector.load(uniform_patterns([255], bench.projector.caps.size))
    bench.projector.show(0)
    return float(bench.camera.snap().image[60:70, 90:100].mean() - BLACK)


def grey_of(lumens: float, wavelength_nm: float, exposure_s: float = EXPOSURE_S, gain_db: float = 0) -> float:
    """The whole chain by hand for `plain`'s camera and projector at 475 mm."""
    width_m = 912 / (1.2 * 912) * 0.475
    height_m = 1140 / (2 * 1.2 * 912) * 0.475
    watts = lumens / (683 * photopic_efficiency(wavelength_nm))
    on_sensor = watts / (width_m * height_m) * 0.5 * 0.9 / (4 * 2.8**2)
    joules = on_sensor * (13132.8e-6 / 192) ** 2 * exposure_s
    photons = joules / (6.62607015e-34 * 299792458 / (wavelength_nm * 1e-9))
    return photons * 0.6 / 15000 * 10 ** (gain_db / 20) * 4095 * 0.99


@pytest.mark.parametrize(
    ("lumens", "wavelength", "exposure_s", "gain_db"),
    [(0.15, 525, 0.02, 0.0), (0.075, 525, 0.02, 0.0), (0.15, 525, 0.005, 0.0), (0.05, 525, 0.02, 12.0),
     (0.05, 620, 0.02, 0.0), (0.01, 460, 0.02, 0.0)],
)  # fmt: skip
def test_grey_levels_are_those_of_the_chain(
    bench: Bench, lumens: float, wavelength: float, exposure_s: float, gain_db: float
) -> None:
    leds = {"led": {"lumens": lumens, "wavelength_nm": wavelength}}
    stand(bench, exposure_s, gain_db, **facing(projector=projector(leds=leds, lit=["led"])))
    expected = grey_of(lumens, wavelength, exposure_s, gain_db)
    assert 200 < expected < 4000
    assert grey_level(bench) == pytest.approx(expected, rel=0.01)


def test_light_of_two_colours_adds_up(bench: Bench) -> None:
    leds = {
        "red": {"lumens": 0.04, "wavelength_nm": 620},
        "green": {"lumens": 0.06, "wavelength_nm": 525},
        "blue": {"lumens": 5.0, "wavelength_nm": 460},
    }

    def of(*lit: str) -> float:
        stand(bench, **facing(projector=projector(leds=leds, lit=list(lit))))
        return grey_level(bench)

    both, red, green = of("red", "green"), of("red"), of("green")
    assert both == pytest.approx(red + green, rel=0.005)
    assert both == pytest.approx(grey_of(0.04, 620) + grey_of(0.06, 525), rel=0.01)


@pytest.mark.parametrize("gain_db", [0.0, 12.0])
def test_photon_transfer_through_the_camera(bench: Bench, gain_db: float) -> None:
    """Variance against mean of a card under uniform patterns: the slope is the gain, in numbers an electron.

    A variance of 24576 differences is good to 0.9 %, eight of them to 0.4 %.
    """
    of = stand(bench, EXPOSURE_S / 10 ** (gain_db / 20), gain_db)
    greys = [20, 50, 80, 110, 140, 170, 200, 230]
    bench.projector.load(uniform_patterns(greys, of.projector.size))
    means, variances = [], []
    for i in range(len(greys)):
        bench.projector.show(i)
        first, second = (bench.camera.snap().image.astype(np.float64) for _ in range(2))
        assert max(first.max(), second.max()) < 4095
        means.append((first + second).mean() / 2)
        variances.append((first - second).var() / 2)
    slope, at_zero = np.polyfit(means, variances, 1, w=1 / np.array(variances))
    gain = 4095 * 0.99 / 15000 * 10 ** (gain_db / 20)
    assert slope == pytest.approx(gain, rel=0.05)
    assert at_zero + slope * BLACK == pytest.approx(gain**2 * 2.5**2 + 1 / 12, abs=0.05 * variances[0])


@pytest.mark.parametrize("binning", [2, 4])
def test_binning_sums_light_and_noise(bench: Bench, binning: int) -> None:
    """As bright as without, since wells are binned too; noise falls with the side of the pixel."""

    def frames(binning: int) -> tuple[Image, Image]:
        of = stand(bench, camera={**plain()["camera"], "binning": binning})
        bench.projector.load(uniform_patterns([200], of.projector.size))
        bench.projector.show(0)
        return bench.camera.snap().image, bench.camera.snap().image

    fine, coarse = frames(1), frames(binning)
    assert coarse[0].shape == (128 // binning, 192 // binning)
    assert coarse[0].mean() == pytest.approx(fine[0].mean(), rel=0.002)
    noise = [np.std(a.astype(float) - b) for a, b in (fine, coarse)]
    pixels = coarse[0].size
    assert noise[0] / noise[1] == pytest.approx(binning, rel=4 / math.sqrt(2 * pixels))


# Ways of light ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def groove(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A steep V, whose sides light each other, as an item."""
    profile = [(-30, 0), (30, 0), (30, 30), (25, 30), (0, 3), (-25, 30), (-30, 30)]
    body = Manifold.extrude(CrossSection([profile]), 60).to_mesh()
    mesh = trimesh.Trimesh(body.vert_properties[:, :3], body.tri_verts)
    mesh.vertices = mesh.vertices[:, [0, 2, 1]] * [1, -1, 1] + [0, 30, 0]  # upright
    path = tmp_path_factory.mktemp("part") / "groove.stl"
    save_stl(mesh, path)
    pose = {"rotation_deg": [180, 0, 0], "translation_mm": [0, 0, 460]}
    return {"mesh": str(path), "pose": pose}


SOFT = {"kind": "translucent", "radius_mm": 1.0}


@pytest.mark.parametrize(
    ("changes", "path", "why"),
    [
        ({}, "transport", None),
        ({"material": {"kind": "glossy"}}, "transport", None),
        ({"render": {"bounces": 2}}, "linear", "'render.bounces' is 2"),
        ({"material": SOFT}, "linear", "a translucent material"),
        ({"materials": {"wax": SOFT}}, "transport", None),
        ({"render": {"path": "reference"}}, "reference", None),
        ({"render": {"path": "linear"}}, "linear", None),
    ],
)
def test_the_light_path_is_chosen_by_the_materials_and_bounces(
    changes: dict[str, Any], path: str, why: str | None
) -> None:
    of = world(**changes)
    assert of.path == path
    assert (why or "None") in str(of.indirect)


def test_one_translucent_item_makes_the_world_linear() -> None:
    card = {**plain()["items"]["card"], "material": "wax"}
    of = world(items={"soft": card}, materials={"wax": SOFT})
    assert of.path == "linear"
    assert "'items.soft'" in str(of.indirect)


@pytest.mark.whole
def test_a_groove_takes_the_linear_path_and_is_correct(
    blender: Blender, groove: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    """Four bounces: what one basis gives is what rendering the pattern gives, to 0.2 grey levels."""
    caplog.set_level(logging.INFO, "sim.light")
    fringes = Sinusoid(axis="x", stripes=16, steps=4)
    effort = {"bounces": 4, "samples": 4, "subpixels": 1}
    pictures = []
    for path in ("auto", "reference"):
        of = world(items={"groove": groove}, render={**effort, "path": path})
        patterns = make_patterns(Plan(fringes=(fringes,)), of.projector.size, of.projector.lattice)
        pictures.append(Light(of, blender).irradiance(SceneState("groove"), ShownPattern(tuple(patterns), 1)))
    assert "takes the light path 'linear', because there is interreflection" in caplog.text
    direct = Light(world(items={"groove": groove}), blender).irradiance(
        SceneState("groove"), ShownPattern(tuple(patterns), 1)
    )
    assert (pictures[1] - direct).max() > 0.05, "the groove must light itself"
    assert np.abs(pictures[0] - pictures[1]).max() < 0.2 / 255


@pytest.mark.nightly
@pytest.mark.parametrize("path", ["transport", "linear", "reference"])
def test_ambient_light_is_the_same_by_any_light_path(bench: Bench, path: str) -> None:
    """Ambient light is on the whole card, whether the projector is dark or not."""
    patterns = uniform_patterns([0, 255], world().projector.size)
    levels = {}
    for ambient in (0.0, 0.25):
        stand(bench, ambient=ambient, render={"path": path, "subpixels": 1})
        bench.projector.load(patterns)
        for i in range(2):
            bench.projector.show(i)
            levels[ambient, i] = bench.shared.irradiance(CameraSettings(EXPOSURE_S), 0)
        bench.projector.blank()
        levels[ambient, 2] = bench.shared.irradiance(CameraSettings(EXPOSURE_S), 0)
    for i in range(3):
        np.testing.assert_allclose(levels[0.25, i] - levels[0.0, i], 0.25 * 0.9, atol=1e-6)
    assert levels[0.0, 2].max() == 0
    assert levels[0.0, 1].min() > 0.3
