"""The twin as matching uses it: its initial parameters, changes of them, and the files it writes."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from fpplab.devices.rig import Rig
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import Pattern, make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from sim.build import SceneState
from sim.light import Light, ShownPattern, plane
from sim.light.point_errors import displaced_by_errors
from sim.matching.loss import board_mask, subsample_pixels
from sim.matching.steps import SAMPLED_POSES
from sim.parameters import TwinParameters
from sim.sensor import SensorModel
from sim.texture import MirrorTexture, PatternTextures
from sim.twin import Twin
from sim.worker import Blender
from sim.world import World
from tests.sim.conftest import SIZE, plain

SETTINGS = CameraSettings(0.02, bits=12)
PLAN = Plan(fringes=(Sinusoid(axis="x", stripes=32, steps=3),))
EXACT = {"subpixels": 2, "cache": False}


def _bent() -> World:
    """The reference whose data sheet is the plain world: every parameter that can be matched is different."""
    data = plain(ambient=0.05, vibration_mm=0.02, render=EXACT)
    data["camera"] |= {"focus_mm": 440.0, "f_number": 4.0, "vignetting": 5.0, "centre_offset_px": [4, 3]}
    data["camera"]["sensor"] = {"black_level": 0.02, "full_well_e": 12000.0, "read_noise_e": 4.0}
    data["projector"] |= {
        "response": {"a": 0.7, "b": 0.06, "g": 1.2},
        "blur": 0.8,
        "focus_mm": 470.0,
        "aperture_mm": 15.0,
        "throw_ratio": 1.19,
        "leds": {"green": {"lumens": 0.3, "wavelength_nm": 525}},
    }
    data["items"]["board"] |= {"reflectance": 0.8, "ink": 0.1}
    return config.validate(data, World, "test")


def _nominal() -> World:
    return config.validate(plain(render=EXACT), World, "test")


def _twin(of: World, board: str = "board") -> Twin:
    return Twin.of(of, board, Blender("bench"))  # which no board needs, so it does not start


def _patterns(of: Twin) -> tuple[Pattern, ...]:
    projector = of.parameters.calibration.projector
    return make_patterns(PLAN, projector.size, projector.lattice)


@pytest.fixture
def twin() -> Twin:
    return _twin(_nominal())


def test_the_twin_starts_with_the_parameters_of_its_file() -> None:
    of = _bent()
    parameters = _twin(of).parameters
    assert parameters.white == 1
    assert parameters.response == Curve(a=0.7 / 0.76, b=0.06 / 0.76, g=1.2)
    assert parameters.ambient == 0.05 / 0.76
    assert (parameters.paper, parameters.ink) == (0.8, 0.1)
    assert (parameters.camera_focus_mm, parameters.f_number, parameters.vignetting) == (440, 4, 5)
    assert len(parameters.poses) == 4
    assert parameters.calibration.camera.matrix[0, 0] == of.camera_model().matrix[0, 0]


def test_expected_levels_are_the_mean_of_the_bench_s_frames() -> None:
    """The same world through the virtual bench's devices: the twin gives the same."""
    of = _bent()
    twin = _twin(of)
    patterns = _patterns(twin)
    levels = twin.expected(2, patterns, SETTINGS)
    light, sensor = Light(of, Blender("bench"), analytic=True), SensorModel.of(of)
    for n in range(len(patterns)):
        picture = light.irradiance(SceneState("board", 2), ShownPattern(patterns, n))
        frames = np.stack([sensor.expose(picture, SETTINGS, k) for k in range(60)]).astype(np.float64)
        lit = picture > 0.02
        error = (frames.mean(axis=0) - levels[n])[lit]
        noise = frames.std(axis=0)[lit] / np.sqrt(60)
        assert abs(error.mean()) < 5 * noise.mean() / np.sqrt(lit.sum())
        assert np.abs(error / noise).mean() == pytest.approx(np.sqrt(2 / np.pi), rel=0.1)


@pytest.mark.parametrize("ambient", [0.05, 0.0])
def test_expected_at_some_pixels_agrees_with_the_whole_image(ambient: float) -> None:
    """Also at pixels that see nothing, and not in the image's order."""
    twin = _twin(_bent())
    twin = twin.with_parameters(replace(twin.parameters, ambient=ambient))
    patterns, random = _patterns(twin), np.random.default_rng(0)
    pixels = random.integers(0, SIZE[1], 500), random.integers(0, SIZE[0], 500)
    whole = twin.expected(2, patterns, SETTINGS)[:, *pixels]
    np.testing.assert_array_equal(twin.expected_at(2, patterns, SETTINGS, pixels), whole)
    assert len(np.unique(whole)) > 100
    assert np.count_nonzero(whole == whole.min()) > 100


@pytest.mark.whole
def test_rendered_light_at_some_pixels_agrees_with_the_whole_image(blender: Blender) -> None:
    """Of a part that is not traced, for its gloss."""
    data = _bent().model_dump(mode="json")
    data["material"] = {"kind": "glossy", "reflectance": 0.9, "gloss": 0.04, "gloss_roughness": 0.5}
    of = config.validate(data, World, "test")
    light, size = Light(of, blender, analytic=True), of.projector.size
    patterns = tuple(uniform_patterns([255, 64], size))
    pixels = np.arange(40, 80), np.arange(90, 130)
    found = light.irradiance_at(SceneState("pillars"), patterns, pixels)
    whole = [light.irradiance(SceneState("pillars"), ShownPattern(patterns, n)) for n in range(2)]
    np.testing.assert_array_equal(found, [one[pixels] for one in whole])
    assert found[0].min() > 2 * found[1].max() > 0


def test_with_another_world_s_parameters_the_twin_gives_its_pictures(twin: Twin) -> None:
    """Brightness too: what the lamps differ by is in `white`."""
    bench = _twin(_bent())
    patterns = _patterns(bench)
    seen = bench.expected(1, patterns, SETTINGS)
    levels = [_white_level(w) for w in (_nominal(), _bent())]
    twin = twin.with_parameters(replace(bench.parameters, white=0.76 * levels[1] / levels[0]))
    found = twin.expected(1, patterns, SETTINGS)
    assert np.ptp(seen) > 500
    np.testing.assert_allclose(found, seen, atol=0.01)


def _white_level(of: World) -> float:
    sensor = SensorModel.of(of)
    return sensor.gain(SETTINGS) * sensor.electrons(1.0, 1.0)


def _changed(twin: Twin, **fields: Any) -> np.ndarray[Any, np.dtype[np.float32]]:
    patterns = _patterns(twin)
    twin = twin.with_parameters(replace(twin.parameters, **fields))
    return twin.expected(0, patterns, SETTINGS)


@pytest.mark.parametrize("fields", [{"f_number": 5.6}, {"full_well_e": 9000.0}])
def test_the_white_level_does_not_depend_on_lens_and_sensor(twin: Twin, fields: dict[str, Any]) -> None:
    before = _changed(twin)
    np.testing.assert_allclose(_changed(twin, **fields), before, rtol=1e-5)


def test_white_scales_all_light(twin: Twin) -> None:
    black = 0.01 * 4095
    before = _changed(twin, ambient=0.03)
    np.testing.assert_allclose(
        _changed(twin, ambient=0.03, white=0.5) - black, 0.5 * (before - black), atol=2e-3
    )
    half = _changed(twin, ambient=0.03, white=0.5, black_level=0.05) - 0.05 * 4095
    whole = _changed(twin, ambient=0.03, white=1.0, black_level=0.01) - black
    np.testing.assert_allclose(half, 0.5 * whole, atol=2e-3)


def test_a_changed_pose_moves_the_picture_and_a_changed_lamp_keeps_the_table(twin: Twin) -> None:
    before = _changed(twin)
    poses = twin.parameters.poses
    tables = twin._light._tables._results
    held = dict(tables)
    assert len(held) == 1
    _changed(twin, response=Curve(a=0.9, b=0.1, g=1.1), ambient=0.1, read_noise_e=9.0)
    assert dict(twin._light._tables._results) == held
    moved = RigidTransform(poses[0].rotation, poses[0].translation + [0.5, 0, 0])
    nominal = {"response": Curve(a=1.0, b=0.0, g=1.0), "ambient": 0.0}
    assert np.abs(_changed(twin, poses=(moved, *poses[1:]), **nominal) - before).max() > 100
    np.testing.assert_array_equal(_changed(twin, poses=poses), before)


def test_frames_have_the_sensor_s_noise_and_every_draw_is_another(twin: Twin) -> None:
    patterns = _patterns(twin)[:1]
    levels = twin.expected(0, patterns, SETTINGS)[0]
    frames = np.stack([twin.frames(0, patterns, SETTINGS)[0] for _ in range(40)]).astype(np.float64)
    lit = levels > 500
    gain = SensorModel.of(_nominal()).gain(SETTINGS)
    variance = gain**2 * ((levels[lit] - 41) / gain + 2.5**2) + 1 / 12
    assert np.mean(frames.var(axis=0, ddof=1)[lit] / variance) == pytest.approx(1, rel=0.03)


@pytest.mark.whole
def test_vibration_is_that_of_a_moved_item(twin: Twin) -> None:
    """To first order: the pictures' covariance over many frames is that of truly moved ones."""
    shake = 0.02
    shaken = replace(twin.parameters, vibration_mm=shake, read_noise_e=0.0, full_well_e=1e9)
    twin = twin.with_parameters(shaken)  # has hardly any noise
    patterns = _patterns(twin)[:1]
    frames = np.stack(twin.frames(0, 60 * patterns, SETTINGS)).astype(np.float64)
    pose = twin.parameters.poses[0]
    moved = []
    for axis in range(3):
        ends = []
        for sign in (-1, 1):
            place = RigidTransform(pose.rotation, pose.translation + sign * shake * np.eye(3)[axis])
            twin = twin.with_parameters(replace(twin.parameters, poses=(place,)))
            ends.append(twin.expected(0, patterns, SETTINGS)[0].astype(np.float64))
        moved.append((ends[1] - ends[0]) / 2)
    variance = np.sum(np.square(moved), axis=0)
    strong = variance > 50
    assert strong.sum() > 300
    assert frames.var(axis=0)[strong].sum() == pytest.approx(variance[strong].sum(), rel=0.35)


def _grid() -> tuple[Any, Any]:
    rows, columns = np.mgrid[0 : SIZE[1] : 4, 0 : SIZE[0] : 4]
    return rows.ravel(), columns.ravel()


@pytest.mark.whole
def test_slopes_by_the_projector_s_place_agree_with_central_differences() -> None:
    twin, pixels, step = _twin(_bent()), _grid(), 0.05
    start, patterns = twin.parameters, _patterns(twin)
    found = twin.expected_with_slopes(2, patterns, SETTINGS, pixels)
    assert found is not None
    np.testing.assert_array_equal(found[0], twin.expected_at(2, patterns, SETTINGS, pixels))
    known = start.calibration
    for axis in range(2):
        ends = []
        for by in (step, -step):
            matrix = known.projector.matrix.copy()
            matrix[axis, 2] += by
            moved = replace(known, projector=replace(known.projector, matrix=matrix))
            twin = twin.with_parameters(replace(start, calibration=moved))
            ends.append(twin.expected_at(2, patterns, SETTINGS, pixels).astype(np.float64))
        wanted = (ends[0] - ends[1]) / (2 * step)
        # Places are rounded to 24 bits, at column 1000 to 3e-5 texels, as often as there are samples of a
        # pixel; an axis without fringes is rounded too.
        rounding = 3e-5 / step * np.abs(found[1][..., 2:]).max()
        assert np.sqrt(np.mean((found[1][..., 2 + axis] - wanted) ** 2)) < rounding
    assert np.abs(found[1][..., 2]).max() > 1000 * rounding


@pytest.mark.whole
def test_slopes_by_the_board_s_place_add_up_to_the_change_of_level() -> None:
    """Of a print between whose pixels light is interpolated, so that derivatives jump there."""
    twin, pixels, step = _twin(_bent()), _grid(), 0.02
    start, patterns = twin.parameters, _patterns(twin)
    pose = start.poses[2]

    def at(axis: int, by: float) -> tuple[Any, Any]:
        there = twin.with_parameters(start.with_pose(2, pose.moved(by * pose.rotation[:, axis])))
        found = there.expected_with_slopes(2, patterns, SETTINGS, pixels)
        assert found is not None
        return found

    for axis in range(2):
        ends = [at(axis, by)[0].astype(np.float64) for by in (step, -step)]
        along = np.linspace(-step, step, 41)
        slopes = np.mean([at(axis, by)[1][..., axis] for by in along], axis=0)
        wanted = (ends[1] - ends[0]) / (2 * step)
        # the board's edge is a jump, which no derivative shows
        inside = np.abs(slopes - wanted) < 0.1 * np.abs(wanted).max()
        assert inside.mean() > 0.99
        assert np.abs(slopes - wanted)[inside].mean() < 0.01 * np.abs(wanted).mean()


@pytest.mark.whole
def test_light_of_a_displaced_board_agrees_with_a_moved_one(twin: Twin) -> None:
    twin = twin.with_parameters(replace(_twin(_bent()).parameters, vibration_mm=0.0))
    patterns, pose = _patterns(twin)[:1], twin.parameters.poses[1]
    light, still, step = twin._light, SceneState("board", held=pose), 0.003
    with_slopes = light.differentiated(still)
    assert with_slopes is not None
    here = light.irradiance(still, ShownPattern(patterns, 0))
    for axis, move in enumerate(step * np.eye(3)):
        ends = [
            light.irradiance(SceneState("board", held=pose.moved(by * move)), ShownPattern(patterns, 0))
            for by in (1, -1)
        ]
        wanted = 0.5 * (ends[0] - ends[1])
        (picture,) = with_slopes.displaced(patterns, move[None])
        assert np.mean(np.abs(picture - here - wanted)) < 0.02 * np.mean(np.abs(wanted)), axis


def test_pixels_of_a_displaced_board_are_the_same_in_batches(
    twin: Twin, monkeypatch: pytest.MonkeyPatch
) -> None:
    patterns, still = _patterns(twin)[:2], SceneState("board", held=twin.parameters.poses[1])
    moves = np.array([[0.003, -0.002, 0.001], [0.0, 0.004, -0.003]])

    def displaced() -> list[NDArray[np.float32]]:
        light = twin._light.differentiated(still)
        assert light is not None
        return list(light.displaced(patterns, moves))

    at_once = displaced()
    monkeypatch.setattr("sim.light.table.BATCH_PIXELS", 701)
    for one, other in zip(at_once, displaced(), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-6)
    assert np.ptp(at_once[0]) > 0


def test_rays_of_a_pose_are_traced_once_for_its_frames(twin: Twin, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fringes of a board that vibrates need derivatives; light of the room, of the same rays, does not."""
    changed = {
        "vibration_mm": 0.003,
        "projector_flicker": 0.01,
        "ambient": 0.02,
        "pose_errors_px": (0.1, 0.1),
    }
    twin = twin.with_parameters(replace(twin.parameters, **changed))
    calls = []

    def counting(name: str, work: Callable[..., Any]) -> Callable[..., Any]:
        def counted(*inputs: Any, **named: Any) -> Any:
            calls.append(name)
            return work(*inputs, **named)

        return counted

    monkeypatch.setattr(plane, "_trace_tables", counting("rays", plane._trace_tables))
    errors = counting("errors", displaced_by_errors)
    monkeypatch.setattr("sim.light.light.displaced_by_errors", errors)
    twin.frames(1, _patterns(twin), SETTINGS)
    assert calls == ["rays", "errors"]


def test_a_saved_twin_is_a_rig_that_gives_the_same_pictures(twin: Twin, tmp_path: Path) -> None:
    bench = _twin(_bent()).parameters
    twin = twin.with_parameters(replace(bench, vibration_mm=0.0, calibration=_unequal(bench.calibration)))
    patterns = _patterns(twin)
    seen = twin.expected(3, patterns, replace(SETTINGS, gain_db=6.0))
    path = twin.save(tmp_path, replace(SETTINGS, gain_db=6.0))
    assert {p.name for p in tmp_path.iterdir()} == {"rig.yaml", "world.yaml", "calibration.yaml"}
    with Rig.load(path) as rig:
        assert rig.camera_settings(0.02) == replace(SETTINGS, gain_db=6.0)
        found = rig.simulation.twin("board")
        np.testing.assert_allclose(
            found.expected(3, patterns, replace(SETTINGS, gain_db=6.0)), seen, atol=0.02
        )
        assert rig.fixture is not None
        assert rig.fixture.caps.items["board"] == 4


def _unequal(calibration: Calibration) -> Calibration:
    """What only a calibration can hold: unequal focal lengths, eight coefficients."""
    camera = calibration.camera
    matrix = camera.matrix * np.array([[1.0, 1, 1], [1, 1.003, 1], [1, 1, 1]])
    lens = camera.distortion + np.array([0, 0, 0, 0, 0, 0.05, 0.01, 0.001])
    return replace(calibration, camera=replace(camera, matrix=matrix, distortion=lens))


def test_a_saved_twin_states_its_uncertainty(tmp_path: Path) -> None:
    """By fields of its world; what only the board has, such as its poses, is left out."""
    twin = _twin(_bent())
    sigma = {"white": 0.02 * twin.parameters.white, "projector_blur": 0.03, "poses_um": 4.0, "paper": 0.01}
    assert twin.parameters.sigma == {}
    twin = twin.with_parameters(replace(twin.parameters, sigma=sigma))
    twin.save(tmp_path, SETTINGS)
    world = World.load(tmp_path / "world.yaml")
    (lamp,) = world.projector.leds.values()
    assert world.uncertainty == {
        "projector.blur": 0.03,
        "projector.leds.green.lumens": pytest.approx(0.02 * lamp.lumens),
    }
    twin = twin.with_parameters(replace(twin.parameters, sigma={}, camera_focus_mm=None))
    twin.save(tmp_path / "without", SETTINGS)
    assert World.load(tmp_path / "without/world.yaml").uncertainty == {}


def test_a_body_is_scanned_in_the_given_pose(blender: Blender) -> None:
    of = _nominal()
    twin = Twin.of(of, "board", blender)
    patterns = _patterns(twin)
    pose = RigidTransform.from_vectors(np.array([np.pi, 0.0, 0.02]), np.array([3.0, -2.0, 455.0]))
    frames = twin.scan("pillars", pose, patterns, SETTINGS)
    picture = Light(of, blender).irradiance(SceneState("pillars", held=pose), ShownPattern(patterns, 1))
    expected = SensorModel.of(of).expected(picture, SETTINGS)
    sigma = np.sqrt(np.maximum(expected, 1) * SensorModel.of(of).gain(SETTINGS)) + 1
    assert np.percentile(np.abs(frames[1] - expected) / sigma, 99.9) < 5
    assert picture.max() > 0.3
    assert twin.mesh("pillars").is_watertight


def test_pictures_of_a_displaced_body_are_looked_up_once(
    blender: Blender, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the pictures of a whole plan are more than are kept."""
    twin = Twin.of(config.validate(plain(vibration_mm=0.02, render=EXACT), World, "test"), "board", blender)
    patterns, (width, height) = _patterns(twin), twin.world.camera.size
    monkeypatch.setattr("sim.light.light.CACHE_BYTES", 4 * 2 * 4 * width * height)
    looked_up: list[object] = []
    look_up = Light._look_up

    def counted(self: Light, setup: SceneState, levels: Any, states: range, basis: Any) -> Any:
        looked_up.extend((setup.held, n) for n in states)
        return look_up(self, setup, levels, states, basis)

    monkeypatch.setattr(Light, "_look_up", counted)
    pose = RigidTransform.from_vectors(np.array([np.pi, 0.0, 0.02]), np.array([3.0, -2.0, 455.0]))
    twin.scan("pillars", pose, patterns, SETTINGS)
    assert len(looked_up) == len(set(looked_up)) == 4 * len(patterns)


WRONG: list[tuple[Callable[[TwinParameters], TwinParameters], str]] = [
    (lambda p: replace(p, paper=1.2), r"the twin's parameters: 'items\.board\.reflectance' is 1\.2"),
    (lambda p: replace(p, projector_blur=0.1), "'blur' is 0.1: must be 0"),
    (lambda p: replace(p, camera_focus_mm=10.0), "'focus_mm' is 10: must be greater than 'focal_mm'"),
    (lambda p: replace(p, response=Curve(a=0.9, b=0.3, g=1.0)), "at most 1"),
    (lambda p: replace(p, poses=()), "poses"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "said"), WRONG)
def test_what_no_world_can_have_is_refused(
    twin: Twin, change: Callable[[TwinParameters], TwinParameters], said: str
) -> None:
    before = twin.parameters
    with pytest.raises(ConfigError, match=said):
        twin.with_parameters(change(before))
    assert twin.parameters is before


def test_only_a_board_can_be_matched_and_only_bodies_have_a_mesh(twin: Twin) -> None:
    with pytest.raises(ConfigError, match=r"'items\.card' is no board; there are board"):
        _twin(_nominal(), "card")
    with pytest.raises(ConfigError, match="no item 'cup'"):
        next(twin.expected_of_greys("cup", np.ones(1), SETTINGS))
    with pytest.raises(ConfigError, match="is flat: only artefacts and parts have a mesh"):
        twin.mesh("card")


def test_pictures_of_greys_are_those_of_their_patterns(twin: Twin) -> None:
    greys, size = np.array([0.0, 64.0, 200.0, 255.0]) / 255, twin.world.projector.size
    patterns = uniform_patterns([0, 64, 200, 255], size)
    pixels = tuple(index.ravel() for index in np.indices(twin.world.camera.size[::-1])[:, ::7, ::7])
    seen = twin.expected_part("card", twin.pose_of("card"), patterns, SETTINGS, (pixels[0], pixels[1]))
    pictures = list(twin.expected_of_greys("card", greys, SETTINGS))
    assert seen.max() > 1000
    np.testing.assert_allclose([picture[pixels] for picture in pictures], seen, rtol=1e-5, atol=1e-3)


def test_textures_of_compared_poses_are_kept_from_one_set_of_parameters_to_the_next(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A fit asks for all its poses with one parameter changed, and then for all with the next."""
    twin = _twin(World.load(config.find_config("world_twin", "world")).binned(8))
    twin = twin.with_parameters(replace(twin.parameters, projector_focus_mm=477.0))
    poses, images = range(SAMPLED_POSES), (0, 4, 8, 10, 16, 20, 24, 26)
    projector = twin.parameters.calibration.projector
    patterns = make_patterns(Plan.load("plan_board"), projector.size, projector.lattice)
    made: list[MirrorTexture] = []
    make = MirrorTexture.textures

    def counted(texture: MirrorTexture, *wanted: Any) -> PatternTextures:
        made.append(texture)
        return make(texture, *wanted)

    monkeypatch.setattr(MirrorTexture, "textures", counted)
    shown = tuple(patterns[n] for n in images)

    def see(of: Twin) -> None:
        camera = of.parameters.calibration.camera
        for pose in poses:
            board = board_mask(camera, of.parameters.poses[pose], of.target)
            of.expected_at(pose, shown, SETTINGS, subsample_pixels(board, 500))

    see(twin)
    assert len(made) == SAMPLED_POSES
    see(twin.with_parameters(replace(twin.parameters, ambient=0.02)))
    assert len(made) == SAMPLED_POSES
    see(twin.with_parameters(replace(twin.parameters, projector_blur=0.9)))
    assert len(made) == 2 * SAMPLED_POSES
