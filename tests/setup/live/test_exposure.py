"""The advised exposure: by arithmetic, and on benches, where one step leads to the right peak."""

import math
from pathlib import Path

import numpy as np
import pytest

from fpplab.core.conventions import Lattice
from fpplab.devices import CameraCaps, CameraSettings, ProjectorCaps
from fpplab.setup.live.exposure import (
    GOALS,
    ExposureLimits,
    LightLevels,
    advise_exposure,
    levels_of_image,
)
from fpplab.setup.live.orders import Order
from fpplab.setup.live.patterns import View
from tests.setup.live.benches import PLAN, Operator, operate, rig_file

WIDE = ExposureLimits((1e-5, 10.0), (0.0, 24.0))


def settings(exposure_s: float, gain_db: float = 0.0) -> CameraSettings:
    return CameraSettings(exposure_s, gain_db, 8)


def test_light_is_proportional_to_exposure_and_gain() -> None:
    advice = advise_exposure(LightLevels(0.22, 0.0), settings(0.01), WIDE)
    assert (advice.exposure_s, advice.gain_db) == (pytest.approx(0.04), 0.0)
    assert advice.peak == pytest.approx(GOALS.peak)
    assert not advice.is_right
    # Gain is given back first: 12 dB are a factor of 3.98.
    advice = advise_exposure(LightLevels(GOALS.peak, 0.0), settings(0.01, 12.0), WIDE)
    assert (advice.exposure_s, advice.gain_db) == (pytest.approx(0.01 * 10**0.6), 0.0)


@pytest.mark.parametrize("peak", [0.03, 0.2, 0.99])
def test_the_black_level_does_not_grow_with_the_exposure(peak: float) -> None:
    advice = advise_exposure(LightLevels(peak, 0.0, black=0.02), settings(0.01), WIDE)
    grown = 0.02 + (peak - 0.02) * advice.exposure_s / 0.01
    assert grown == pytest.approx(GOALS.peak)
    assert advice.peak == pytest.approx(GOALS.peak)


@pytest.mark.parametrize("peak", [0.05, 0.3, 0.44, 0.6, 0.95])
def test_exposures_are_whole_bit_plane_periods_and_gain_does_the_rest(peak: float) -> None:
    limits = ExposureLimits((1e-5, 1.0), (0.0, 24.0), period_s=1 / 60)
    advice = advise_exposure(LightLevels(peak, 0.0), settings(3 / 60), limits)
    periods = advice.exposure_s * 60
    assert periods == pytest.approx(round(periods), abs=1e-9)
    assert periods >= 1
    light = advice.exposure_s * 10 ** (advice.gain_db / 20)
    assert light == pytest.approx(3 / 60 * GOALS.peak / peak, rel=0.011)
    assert advice.peak == pytest.approx(GOALS.peak, rel=0.011)
    assert not advice.limits


def test_one_period_that_is_too_bright_is_said() -> None:
    limits = ExposureLimits((1e-5, 1.0), (0.0, 24.0), period_s=0.02)
    advice = advise_exposure(LightLevels(0.999, 0.5), settings(0.02), limits)
    assert advice.exposure_s == 0.02
    assert advice.peak is None
    assert "one period of the projector's bit planes" in advice.limits[0]
    assert "dim the lamp" in advice.limits[0]


def test_a_weak_lamp_is_said_with_what_is_reached() -> None:
    limits = ExposureLimits((1e-5, 0.1), (0.0, 6.0))
    advice = advise_exposure(LightLevels(0.01, 0.0), settings(0.05), limits)
    assert (advice.exposure_s, advice.gain_db) == (0.1, 6.0)
    reached = 0.02 * 10 ** (6 / 20)
    assert advice.peak == pytest.approx(reached)
    assert "the lamp is weak" in advice.limits[0]
    assert f"reach {100 * reached:.0f} % of full scale" in advice.limits[0]


def test_light_of_the_room_is_said() -> None:
    advice = advise_exposure(LightLevels(0.8, 0.0, 0.5), settings(0.01), WIDE)
    assert "light of the room takes 62 % of the range" in advice.limits[0]
    assert not advise_exposure(LightLevels(0.8, 0.0, 0.3), settings(0.01), WIDE).limits


def test_what_is_saturated_takes_a_further_step() -> None:
    advice = advise_exposure(LightLevels(1.0, 0.2), settings(0.08), WIDE)
    assert advice.exposure_s == pytest.approx(0.02)
    assert advice.peak is None
    assert not advice.is_right


def test_limits_of_triggered_plans_are_what_the_projector_can_show() -> None:
    camera = CameraCaps((8, 8), (8,), (1e-5, 10.0), (0.0, 12.0), ("hardware",), readout_s=0.004)
    projector = ProjectorCaps((8, 8), Lattice.SQUARE, {8: 0.00833}, 1, 99, longest_s=0.02, period_s=0.02)
    triggered = PLAN.model_copy(update={"trigger": "triggered"})
    limits = ExposureLimits.by_devices(camera, projector, triggered)
    assert limits.exposure_s == (pytest.approx(0.00433), pytest.approx(0.016))
    assert limits.period_s == 0.0
    advice = advise_exposure(LightLevels(0.001, 0.0), settings(0.016), limits)
    assert "the longest exposure of the projector" in advice.limits[0]
    assert ExposureLimits.by_devices(camera, projector, PLAN).period_s == 0.02


@pytest.mark.parametrize("period_s", [0.0, 0.02])
def test_keys_step_up_and_down(period_s: float) -> None:
    limits = ExposureLimits((1e-5, 1.0), (0.0, 12.0), period_s)
    exposure = 0.04
    up = limits.stepped(exposure, math.sqrt(2))
    assert up == pytest.approx(0.06 if period_s else 0.04 * math.sqrt(2))
    assert limits.stepped(exposure, math.sqrt(0.5)) == pytest.approx(
        0.02 if period_s else 0.04 * math.sqrt(0.5)
    )


def test_highlights_may_saturate_and_dark_surroundings_do_not_count() -> None:
    image = np.full((200, 200), 10, np.uint8)
    image[50:150, 50:150] = 180
    image[50:56, 50:56] = 255  # 0.36 % of what is lit
    levels = levels_of_image(image, 8)
    assert levels.peak == pytest.approx(180 / 255)
    assert not levels.is_saturated
    image[50:60, 50:60] = 255  # 1 %
    assert levels_of_image(image, 8).is_saturated


@pytest.mark.parametrize("exposure_s", [0.002, 0.3])
def test_the_advice_leads_to_the_right_peak(exposure_s: float, tmp_path: Path) -> None:
    """From a dark image in one step; from a saturated one in several, which one key takes."""
    operator = Operator(Order.ADVICE, after=9)
    plan = PLAN.model_copy(update={"exposure_s": exposure_s})
    operate(rig_file(tmp_path), operator, plan=plan, frames=64)
    exposures = list(dict.fromkeys(f.settings.exposure_s for f in operator.frames))
    assert len(exposures) == 2 if exposure_s == 0.002 else len(exposures) > 2
    last = operator.seen[-1]
    assert last.levels is not None
    assert last.view is View.MEASURE
    # At 2 ms the peak is 23 of 255 levels, whose rounding is 2 % of it.
    assert last.levels.peak == pytest.approx(GOALS.peak, abs=0.02)
    assert last.levels.black == pytest.approx(
        0.01, abs=0.004
    )  # the world's camera; it does not grow with light
    assert last.levels.saturated == 0.0
    assert max(f.image.max() for f in operator.frames[-8:]) < 255


def test_a_camera_that_refuses_an_exposure_keeps_the_former(tmp_path: Path) -> None:
    operator = Operator(*[Order.MORE_GAIN] * 2, Order.LESS_GAIN, Order.LONGER, Order.QUIT, after=2)
    sensor = {"exposure_s": [1e-4, 0.021], "gain_db": [0.0, 1.5]}
    camera = {"sensor_size": [912, 608], "pixel_um": 14.4, "focal_mm": 35.0, "sensor": sensor}
    operate(rig_file(tmp_path, camera=camera), operator)
    said = list(dict.fromkeys(status.message for status in operator.seen))
    assert said[1] == "exposure 20 ms, gain 1 dB"
    assert "gain_db is 2" in said[2]
    assert said[3] == "exposure 20 ms, gain 0 dB"
    assert "exposure_s is 0.0282" in said[4]
    assert operator.frames[-1].settings == settings(0.02)
