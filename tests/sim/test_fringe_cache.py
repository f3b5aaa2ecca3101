"""The cache of fringe sets: each acquired once, shared between step counts, with reproducible noise."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.devices import CameraSettings
from fpplab.devices.rig import Rig
from fpplab.optimisation.arrangement import StageCalibrations
from fpplab.optimisation.fringe_cache import FringeSetCache, MeasuringSetup
from fpplab.patterns.fringe_sets import PatternSet, stepped_fringes
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from sim.build import SceneState
from sim.world import World
from tests.sim.conftest import RIG, plain, write_world

LIKE = Plan(fringes=(Sinusoid(axis="x", stripes=1, steps=3),))
CARD = MeasuringSetup("card", 0.02)
BASE, MIDDLE, FINE = (stepped_fringes("x", stripes, 12) for stripes in (1.0, 7.3, 61.7))

Sets = Callable[..., FringeSetCache]


@pytest.fixture(scope="module", params=[0.0, 0.02], ids=["still", "vibrating"])
def rig(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """A card whose illumination is computed analytically."""
    folder = tmp_path_factory.mktemp("rig")
    write_world(folder, plain(vibration_mm=request.param))
    text = RIG.replace("world.yaml}", "world.yaml, analytic: true}").replace("bits: 12", "bits: 8")
    (folder / "rig.yaml").write_text(text)
    with Rig.load(folder / "rig.yaml") as opened:
        yield opened


@pytest.fixture
def sets(rig: Rig) -> Sets:
    """Make an empty cache on the rig."""
    return lambda **options: FringeSetCache(rig, LIKE, lambda setup: rig.fixture.mount(setup.item), **options)  # type: ignore[union-attr]


def stack(
    sets: FringeSetCache, *fringes: PatternSet, seed: int = 1, setup: MeasuringSetup = CARD
) -> NDArray[np.uint8]:
    return np.stack(sets.frames(setup, fringes, seed))


def fewer(fringes: PatternSet, steps: int) -> PatternSet:
    return fringes.model_copy(update={"steps": steps})


@pytest.mark.whole
@pytest.mark.parametrize("steps", [6, 4, 3])
def test_subset_of_a_set_equals_the_set_acquired_alone(sets: Sets, steps: int) -> None:
    of_twelve, alone = sets(), sets()
    stack(of_twelve, BASE, FINE)
    taken = stack(of_twelve, fewer(BASE, steps), fewer(FINE, steps))
    assert of_twelve.acquired == 24
    np.testing.assert_array_equal(taken, stack(alone, fewer(BASE, steps), fewer(FINE, steps)))
    assert alone.acquired == 2 * steps


@pytest.mark.whole
def test_five_steps_are_no_subset_of_twelve(sets: Sets) -> None:
    store = sets()
    stack(store, BASE)
    stack(store, fewer(BASE, 5))
    assert store.acquired == 17


@pytest.mark.whole
def test_frames_do_not_depend_on_earlier_measurements(sets: Sets) -> None:
    one, other = sets(), sets()
    first = stack(one, BASE, MIDDLE, FINE)
    stack(other, fewer(BASE, 5), fewer(MIDDLE, 3), seed=4)
    stack(other, BASE, stepped_fringes("x", 7.4, 12), FINE)
    np.testing.assert_array_equal(first, stack(other, BASE, MIDDLE, FINE))


@pytest.mark.whole
def test_changed_frequency_acquires_one_set_only(sets: Sets) -> None:
    store = sets()
    stack(store, BASE, MIDDLE, FINE)
    stack(store, BASE, stepped_fringes("x", 8.0, 12), FINE)
    assert store.acquired == 48


@pytest.mark.whole
def test_noise_differs_between_seeds_positions_and_steps(sets: Sets) -> None:
    """In a large share of the pixels."""
    store = sets()
    one, again, elsewhere = stack(store, BASE), stack(store, BASE, seed=2), stack(store, FINE, BASE)[12:]
    assert (one != again).mean() > 0.3
    assert (one != elsewhere).mean() > 0.3
    assert (one != stack(store, BASE, setup=replace(CARD, taken=1))).mean() > 0.3
    halves = one[:6].astype(int) + one[6:]  # half a period apart: the fringes cancel in the sum
    assert np.abs(halves - halves.mean(axis=0)).mean() > 0.3


@pytest.mark.whole
def test_similar_candidates_have_common_noise(sets: Sets) -> None:
    """So that the noise cancels in their difference."""
    near = stepped_fringes("x", 7.3001, 12)
    frames = [stack(sets(), BASE, one)[12:].astype(float) for one in (MIDDLE, near)]
    other = stack(sets(), BASE, near, seed=2)[12:].astype(float)
    assert np.std(frames[0] - frames[1]) < 0.5 * np.std(frames[0] - other)


@pytest.mark.whole
def test_evicted_set_is_acquired_again_with_equal_frames(sets: Sets) -> None:
    store = sets(keep_bytes=1)
    before = stack(store, BASE)
    stack(store, FINE)
    np.testing.assert_array_equal(before, stack(store, BASE))
    assert store.acquired == 36


@pytest.mark.whole
def test_cached_frames_do_not_move_the_rig(rig: Rig) -> None:
    stood: list[MeasuringSetup] = []
    store = FringeSetCache(rig, LIKE, stood.append)
    rig.fixture.mount("card")  # type: ignore[union-attr]
    stack(store, BASE)
    stack(store, fewer(BASE, 6))
    assert stood == [CARD]
    brighter = MeasuringSetup("card", 0.03)
    assert stack(store, BASE, setup=brighter).mean() > 1.2 * stack(store, BASE).mean()
    assert stood == [CARD, brighter]


def test_noise_numbers_are_used_once_then_frames_are_counted(rig: Rig) -> None:
    """The simulation uses each number for one frame, and then counts frames again."""
    rig.fixture.mount("card")  # type: ignore[union-attr]
    camera, projector = rig.camera, rig.projector
    camera.configure(CameraSettings(0.02))
    projector.load(make_patterns(LIKE, projector.caps.size, projector.caps.lattice))
    projector.show(0)
    told = []
    for _ in range(2):
        rig.simulation.draw([11, 12])
        told.append([camera.snap().image for _ in range(3)])
    np.testing.assert_array_equal(told[0][:2], told[1][:2])
    assert (told[0][0] != told[0][1]).any()
    assert (told[0][2] != told[1][2]).any()


def test_turned_projector_agrees_with_the_turned_calibration(tmp_path: Path) -> None:
    world = World.load(write_world(tmp_path, plain()))
    known = Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(12.0), {})
    turned = SceneState("card", stage_mm=12.0, convergence_deg=1.5).T_projector_camera(world)
    np.testing.assert_allclose(
        turned.matrix, StageCalibrations({12.0: known}).at(12.0, 1.5).T_projector_camera.matrix, atol=1e-12
    )
