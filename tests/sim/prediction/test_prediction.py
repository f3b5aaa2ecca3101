"""Predictions from a sample of rows, beside whole syntheses of the same simulated bench."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fpplab.comparison.alignment import align_mesh
from fpplab.core import config
from fpplab.core.errors import ConfigError
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Predictable
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import FilterRules, Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.reconstruction.points import points_of
from sim.bench import VirtualBench
from sim.build import SceneState
from sim.prediction import Discrepancy, MeasuredFigures, figures_of, predict
from sim.prediction.discrepancy import Deviation
from sim.prediction.figures import SeenShape
from sim.prediction.predict import INNER, MARGIN, choose_sampled_rows, noise_by_surface, plan_seconds
from sim.sampling import FramePart
from sim.world import World

PLAN = Plan(fringes=tuple(Sinusoid(axis="x", stripes=n, steps=4) for n in (1, 8, 48)), exposure_s=0.02)
ITEM = "steps"


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """The virtual bench of the demonstration, at an eighth of the sensor's pixels along each side."""
    with Rig.load(changed("rig_demo", tmp_path_factory.mktemp("rig"), binning=8, subpixels=2)) as opened:
        yield opened


@pytest.fixture(scope="module")
def vibrating(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A matched twin, whose lenses blur and whose items vibrate."""
    with Rig.load(changed("rig_matched", tmp_path_factory.mktemp("matched"), subpixels=2)) as opened:
        yield opened


def changed(name: str, folder: Path, **bench: int) -> Path:
    found = config.find_config(name, "rig")
    data = config.parse_yaml(config.read_text(found), found)
    data["bench"] |= bench
    path = folder / "rig.yaml"
    path.write_text(config.to_yaml(data))
    return path


def measured(rig: Rig, plan: Plan, item: str) -> MeasuredFigures:
    """A whole measurement through the devices."""
    assert isinstance(rig.simulation, Predictable)
    assert rig.fixture is not None
    sampler = rig.simulation.image_part_sampler()
    caps, known, mesh = rig.projector.caps, sampler.calibration, sampler.mesh(item)
    rig.fixture.mount(item, 0)
    settings = rig.camera.configure(rig.camera_settings(plan.exposure_s))
    patterns = rig.projector.load(make_patterns(plan, caps.size, caps.lattice))
    frames = []
    for index in range(len(patterns)):
        rig.projector.show(index)
        frames.append(rig.camera.snap().image)
    decoded = decode(Recording(frames, plan, caps.size, settings.bits, lattice=caps.lattice))
    decoded, cloud = points_of(decoded, known, plan)
    placed = mesh.copy().apply_transform(align_mesh(cloud.points.astype(float), mesh).transform.matrix)
    return figures_of(decoded, cloud, SeenShape.of(placed, known), plan, None, caps.size)


CODES = [
    {"kind": "even", "levels": [1, 0]},
    {"kind": "gray", "axis": "x", "bits": 10},
    {"kind": "shifted", "axis": "x", "stripes": 30, "shifts_deg": [0]},
]


@pytest.mark.whole
def test_codes_of_other_kinds_are_predicted_as_measured(rig: Rig) -> None:
    plan = config.validate({"fringes": CODES, "exposure_s": 0.02}, Plan, "plan")
    found, whole = predict(rig, plan, ITEM), measured(rig, plan, ITEM)
    assert found.figures["distance_um"].value == pytest.approx(whole.distance_um, rel=0.05)
    assert found.figures["noise_um"].value == pytest.approx(whole.noise_um, rel=0.05)
    assert found.figures["completeness"].value == pytest.approx(whole.completeness, rel=0.03)
    assert found.figures["wrong_order"].value < 1e-3
    assert found.stripes == 912 / 4


@pytest.mark.whole
def test_a_prediction_is_that_of_a_whole_synthesis(rig: Rig) -> None:
    found, whole = predict(rig, PLAN, ITEM), measured(rig, PLAN, ITEM)
    assert found.figures["distance_um"].value == pytest.approx(whole.distance_um, rel=0.03)
    assert found.figures["noise_um"].value == pytest.approx(whole.noise_um, rel=0.03)
    assert found.figures["completeness"].value == pytest.approx(whole.completeness, rel=0.03)
    assert found.figures["wrong_order"].value == pytest.approx(whole.wrong_order, rel=0.5, abs=1e-12)
    assert found.figures["seconds"].value == plan_seconds(rig, PLAN)
    assert found.images == 12
    assert found.discrepancy is None
    assert found.figures["place_um"].value < 50.0  # the steps hardly hold it along them
    assert len(found.lengths) > 1
    for length in found.lengths:
        assert length.measured_mm.value == pytest.approx(length.true_mm, abs=0.02), length.name
        assert 0.0 < length.measured_mm.high - length.measured_mm.low < 0.02


@pytest.mark.whole
def test_a_prediction_of_a_vibrating_twin_is_that_of_a_whole_synthesis(vibrating: Rig) -> None:
    """Traced in a sample of rows, beside whole frames that are rendered, each with its own displacement."""
    # The filter keeps single gross errors out of the mean.
    plan = PLAN.model_copy(update={"fringes": PLAN.fringes[:2], "filter": FilterRules()})
    found, whole = predict(vibrating, plan, "pyramid"), measured(vibrating, plan, "pyramid")
    assert found.figures["distance_um"].value == pytest.approx(whole.distance_um, rel=0.03)
    # One scan differs from the next by 1 %, and edges that whole frames alone show add another.
    assert found.figures["noise_um"].value == pytest.approx(whole.noise_um, rel=0.05)
    assert found.figures["completeness"].value == pytest.approx(whole.completeness, rel=0.03)


def test_a_prediction_of_matt_parts_renders_nothing(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def render(*_: object) -> None:
        raise AssertionError("a picture is rendered")

    monkeypatch.setattr("sim.worker.Blender.render", render)
    found = predict(rig, PLAN, "pillars", pixels=4_000)
    assert found.figures["completeness"].value > 0.5


@pytest.mark.whole
def test_rows_are_those_of_whole_frames(rig: Rig) -> None:
    """The mean of many draws is the light of the same pixels in a whole frame, within its noise."""
    assert isinstance(rig.simulation, Predictable)
    assert rig.fixture is not None
    sampler, caps = rig.simulation.image_part_sampler(), rig.projector.caps
    patterns = tuple(make_patterns(PLAN, caps.size, caps.lattice))[8:10]
    settings, rows = rig.camera_settings(PLAN.exposure_s), np.arange(180, 240, 7)
    draws = [sampler.frames(ITEM, patterns, settings, rows, seed) for seed in range(12)]
    assert not np.array_equal(draws[0][0], draws[1][0])
    rig.fixture.mount(ITEM, 0)
    rig.camera.configure(settings)
    rig.projector.load(patterns)
    for n in range(len(patterns)):
        rig.projector.show(n)
        whole = rig.camera.snap().image[rows].astype(float)
        off = np.mean([draw[n] for draw in draws], axis=0) - whole
        assert abs(off.mean()) < 0.1
        assert off.std() < 3.0


@pytest.mark.whole
def test_ambient_light_of_rows_is_that_of_whole_frames(rig: Rig) -> None:
    assert isinstance(rig.simulation, VirtualBench)
    rows = np.arange(180, 240, 7)
    whole = rig.simulation.light.irradiance(SceneState(ITEM), None)[rows]
    assert whole.max() > 0.005
    part = FramePart(ITEM, rows, np.arange(whole.shape[1]))
    np.testing.assert_allclose(rig.simulation.image_part_sampler()._room_light(part), whole, atol=2e-4)


def test_columns_are_those_of_the_rows(rig: Rig) -> None:
    """Without noise, vibration and flicker, light is that of the same pixels among whole rows."""
    assert isinstance(rig.simulation, VirtualBench)
    caps, rows, columns = rig.projector.caps, np.arange(180, 240, 7), np.arange(150, 400, 3)
    patterns = tuple(make_patterns(PLAN, caps.size, caps.lattice))[8:10]
    sampler = rig.simulation.image_part_sampler()
    whole = sampler._pictures(FramePart(ITEM, rows, np.arange(rig.camera.caps.size[0])), patterns)
    part = sampler._pictures(FramePart(ITEM, rows, columns), patterns)
    np.testing.assert_array_equal(part, whole[..., columns])
    frames = sampler.frames(ITEM, patterns, rig.camera_settings(PLAN.exposure_s), rows, 3, columns)
    assert [frame.shape for frame in frames] == [(len(rows), len(columns))] * 2


def test_bands_are_spread_over_the_item() -> None:
    seen = np.zeros((400, 300), bool)
    seen[100:300, 50:250] = True
    rows, inner = choose_sampled_rows(seen, 8_000)
    assert seen[inner].sum() == pytest.approx(8_000, rel=0.15)
    assert rows.min() >= 100 - MARGIN
    assert rows.max() < 300 + MARGIN
    assert set(inner) < set(rows)
    assert all({row - MARGIN, row + MARGIN} <= set(rows) for row in inner)
    assert np.ptp(inner) > 150
    every, same = choose_sampled_rows(seen, 10**6)
    assert np.array_equal(every, same)
    assert len(every) == 200 + 2 * MARGIN > INNER


@pytest.mark.whole
def test_the_interval_holds_what_bench_and_twin_differed_by(rig: Rig) -> None:
    plain = predict(rig, PLAN, ITEM, pixels=5_000)
    noise = Deviation.of([0.2, 0.2, 0.2], fitted=False)
    folder = Path(rig.source).parent
    given = Discrepancy(noise=noise, parts=(ITEM,), not_for="wax", looks_like="subsurface light")
    try:
        given.save(folder)
        wide = predict(rig, PLAN, ITEM, pixels=5_000)
        given.model_copy(update={"parts": ()}).save(folder)
        unknown = predict(rig, PLAN, ITEM, pixels=5_000)
    finally:
        (folder / "discrepancy.yaml").unlink()
    for name in ("distance_um", "noise_um"):
        one, other = plain.figures[name], wide.figures[name]
        assert other.value == one.value
        assert other.high / other.value > np.exp(0.3)
        assert unknown.figures[name].high > 10 * other.high
        assert one.high / one.value < other.high / other.value
        assert other.contains(1.3 * one.value)
    assert wide.figures["wrong_order"].high > plain.figures["wrong_order"].high
    assert wide.summary()["not_for"] == "wax"
    assert wide.summary()["matched"]
    assert [one.surface_known for one in (plain, wide, unknown)] == [True, True, False]
    assert not plain.summary()["matched"]


def test_what_is_not_known_of_a_surface_is_in_the_noise() -> None:
    world = World.load("world_demo")
    painted = world.material.model_copy(update={"sigma": {"reflectance": 0.09}})
    known = noise_by_surface(world.model_copy(update={"material": painted}), ITEM, Discrepancy())
    assert np.log(known).std() == pytest.approx(0.1, rel=0.01)
    same_paint, shown = Discrepancy(parts=("pyramid",)), noise_by_surface(world, ITEM, None)
    np.testing.assert_array_equal(noise_by_surface(world, ITEM, same_paint), [1.0])
    np.testing.assert_array_equal(shown, [1.0])
    unknown = noise_by_surface(world, ITEM, Discrepancy())
    assert unknown.min() == pytest.approx(0.9, rel=1e-3)  # a part reflects all light at most
    assert np.median(unknown) == pytest.approx(1.8, rel=1e-2)


def test_what_cannot_be_predicted_is_refused(rig: Rig) -> None:
    with pytest.raises(ConfigError, match="no item 'cup'"):
        predict(rig, PLAN, "cup")
    with pytest.raises(ConfigError, match="is flat"):
        predict(rig, PLAN, "board")
