"""Focus: measures that neither noise nor exposure change, and whose best is at the true focus of the twin."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from fpplab.core.conventions import Mask
from fpplab.devices import Frame
from fpplab.devices.rig import Rig
from fpplab.devices.rig_lock import watching_rig
from fpplab.patterns.fringes import Pattern
from fpplab.setup.live.focus import AT_BEST_SHARE, FocusMeasure, FocusTracker, camera_sharpness
from fpplab.setup.live.loop import LiveOptions, LiveSetUp
from fpplab.setup.live.orders import Order
from fpplab.setup.live.regions import REGIONS
from fpplab.setup.live.status import LiveStatus
from tests.setup.live.benches import PLAN, Operator, operate, rig_file


def texture(blur_px: float, level: float = 0.5, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    white = np.random.default_rng(3).normal(0, 1, (240, 360))
    smooth = gaussian_filter(white, np.hypot(2.0, blur_px))
    image = level * (1 + 2.0 * smooth)
    return image + np.random.default_rng([seed, 9]).normal(0, noise, image.shape)


def test_sharpness_falls_with_blur_by_the_power_of_the_gradient() -> None:
    """White noise blurred to σ has the variance 1/4πσ², and of it central differences have (1 - exp(-1/σ²))/2
    along each axis."""
    for blur in (0.0, 1.5, 3.0):
        found = camera_sharpness(texture(blur), texture(blur)).whole
        square = 4.0 + blur**2
        expected = 2.0 * np.sqrt((1.0 - np.exp(-1.0 / square)) / (4.0 * np.pi * square))
        assert found == pytest.approx(expected, rel=0.04)


def test_noise_is_no_sharpness_and_brightness_none_either() -> None:
    clean = camera_sharpness(texture(2.0), texture(2.0)).whole
    noisy = camera_sharpness(texture(2.0, noise=0.02, seed=1), texture(2.0, noise=0.02, seed=2)).whole
    same = camera_sharpness(*2 * [texture(2.0, noise=0.02, seed=1)]).whole
    dim = camera_sharpness(0.2 * texture(2.0), 0.2 * texture(2.0)).whole
    assert noisy == pytest.approx(clean, rel=0.02)
    assert same > 1.1 * clean  # what one image alone would make of its noise
    assert dim == pytest.approx(clean)


def test_a_region_without_texture_has_no_focus() -> None:
    falling = np.tile(np.linspace(0.3, 0.8, 360), (240, 1))
    noisy = [falling + np.random.default_rng(k).normal(0, 0.01, falling.shape) for k in (1, 2)]
    found = camera_sharpness(*noisy)
    assert np.isnan(found.regions).all()
    assert found.whole is None
    dark = camera_sharpness(np.zeros((240, 360)), np.zeros((240, 360)))
    assert dark.whole is None


def test_the_best_is_kept_by_region_and_can_be_forgotten() -> None:
    low, high = np.full(REGIONS, 0.2), np.full(REGIONS, 0.4)
    high[0, 0] = np.nan
    tracker = FocusTracker()
    assert tracker.share is None
    for regions, whole in ((low, 0.2), (high, 0.4), (low, 0.2)):
        tracker = tracker.after(FocusMeasure(regions, whole))
    assert tracker.share == pytest.approx(0.5)
    assert tracker.shares[0, 0] == 1.0
    assert tracker.shares[1, 1] == pytest.approx(0.5)
    assert not tracker.summary()["at_best"]
    assert tracker.forgotten().share == 1.0


class TurningALens(Operator):
    """Turns the camera's lens of the simulated bench, step by step, and notes the sharpness at each."""

    def __init__(self, rig: Rig, steps_mm: list[float]) -> None:
        super().__init__()
        self._rig, self._steps, self._frames_there = rig, steps_mm, 0
        self.found: dict[float, float] = {}

    def __call__(
        self, status: LiveStatus, frame: Frame | None, pattern: Pattern | None, dark: Mask | None
    ) -> bool:
        self._frames_there += 1
        if self._frames_there == 17:  # a cycle, and one that may have begun before
            whole = status.camera_focus.now.whole
            assert whole is not None
            self.found[self._world.camera.focus_mm] = whole
            self.turn()
        return True

    @property
    def _world(self):  # type: ignore[no-untyped-def]
        return self._rig.simulation.world  # type: ignore[union-attr]

    def turn(self) -> None:
        self._frames_there = 0
        if not self._steps:
            self.orders.put(Order.QUIT)
            return
        camera = self._world.camera.model_copy(update={"focus_mm": self._steps.pop(0)})
        self._rig.simulation.replace_world(self._world.model_copy(update={"camera": camera}))  # type: ignore[union-attr]


def test_the_cameras_best_is_at_its_true_focus(tmp_path: Path) -> None:
    board = {
        "target": "board.yaml",
        "poses": [{"rotation_deg": [0, 0, 0], "translation_mm": [0, 0, 446]}],
    }
    path = rig_file(
        tmp_path, items={"board": board}, camera={"focus_mm": 406.0, "f_number": 1.4}, mounted="board"
    )
    rig = Rig.load(path)
    operator = TurningALens(rig, [414.0, 422.0, 430.0, 438.0, 446.0, 454.0, 462.0, 470.0, 486.0])
    setup = LiveSetUp(rig, LiveOptions(PLAN), operator.orders, operator)
    with watching_rig(path) as turn:
        setup.run(turn)
    found = operator.found
    assert len(found) == 10
    assert max(found, key=found.__getitem__) == 446.0
    best = setup.status.camera_focus
    assert best.best_whole == pytest.approx(found[446.0])
    assert best.share is not None
    assert best.share < AT_BEST_SHARE
    # It rises to the focus and falls beyond it.
    values = list(found.values())
    assert values[:6] == sorted(values[:6])
    assert values[5:] == sorted(values[5:], reverse=True)


@pytest.mark.whole
def test_the_projectors_best_is_at_its_true_focus(tmp_path: Path) -> None:
    """The stage moves the projector, focused at 463 mm, away from a card that is 450 mm before it."""
    path = rig_file(
        tmp_path,
        projector={
            "T_camera_projector": {"rotation_deg": [0, 0, 0], "translation_mm": [100, 0, 0]},
            "focus_mm": 463.0,
            "aperture_mm": 40.0,
        },
        stage={"travel_mm": [-60, 60], "axis": [0, 0, 1]},
    )
    operator = Operator(Order.HOME, *[Order.BACK] * 8, Order.QUIT, after=10)
    operate(path, operator, stage_step_mm=3.0)
    found = {
        status.stage.position_mm: status.projector_focus.now.whole
        for status in operator.seen
        if status.stage is not None and status.levels is not None
    }
    places, values = np.array(list(found)), np.array(list(found.values()), float)
    assert len(places) == 9
    curve = np.polynomial.Polynomial.fit(places, values, 2)
    assert curve.deriv().roots()[0] == pytest.approx(-13.0, abs=1.0)
    assert places[np.argmax(values)] in (-12.0, -15.0)
