"""The sensor against photon transfer."""

from typing import Any

import numpy as np
import pytest

from fpplab.core import config
from fpplab.devices import CameraSettings
from sim.sensor import MANY_ELECTRONS, SensorModel, colour_shares
from sim.world import Sensor, World
from tests.sim.conftest import plain

SHAPE = (400, 500)
PHOTONS_PER_S = 1.1e6
"""So that white fills nine tenths of the well in 20 ms."""


def flat(level: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.full(SHAPE, level, np.float32)


@pytest.mark.parametrize("level", [0.0, 0.01, 0.05, 0.1, 0.3, 0.8])
@pytest.mark.parametrize(("binning", "gain_db"), [(1, 0.0), (1, 12.0), (4, 0.0)])
def test_variance_is_that_of_photon_transfer(level: float, binning: int, gain_db: float) -> None:
    """K² (N + read²) + 1/12 within four standard errors, where shot noise is drawn either way."""
    model = SensorModel(Sensor(black_level=0.1, read_noise_e=16.0), binning, PHOTONS_PER_S, 1)
    settings = CameraSettings(0.02, gain_db, 12)
    level /= 10 ** (gain_db / 20)
    image = model.expose(flat(level), settings, 0).astype(np.float64)
    gain, electrons = model.gain(settings), model.electrons(level, 0.02)
    mean = 0.1 * 4095 + gain * electrons
    variance = gain**2 * (electrons + (16.0 * binning) ** 2) + 1 / 12
    assert abs(image.mean() - mean) < 4 * np.sqrt(variance / image.size)
    assert abs(image.var() / variance - 1) < 4 * np.sqrt(2 / image.size)


def test_both_kinds_of_shot_noise_are_exercised() -> None:
    model = SensorModel(Sensor(), 1, PHOTONS_PER_S, 1)
    assert model.electrons(0.05, 0.02) < MANY_ELECTRONS < model.electrons(0.1, 0.02)


@pytest.mark.parametrize(("bits", "dtype", "top"), [(8, np.uint8, 255), (12, np.uint16, 4095)])
def test_too_much_light_saturates_at_full_scale(bits: int, dtype: type, top: int) -> None:
    image = SensorModel(Sensor(), 2, PHOTONS_PER_S, 1).expose(flat(3.0), CameraSettings(0.02, 0.0, bits), 0)
    assert image.dtype == dtype
    assert image.min() == image.max() == top


def test_black_level_keeps_read_noise_from_clipping() -> None:
    sensor = Sensor(black_level=0.01, read_noise_e=2.5)
    image = SensorModel(sensor, 1, PHOTONS_PER_S, 1).expose(flat(0.0), CameraSettings(0.02, 0.0, 12), 0)
    assert image.min() > 0
    assert image.mean() == pytest.approx(0.01 * 4095, abs=0.02)


def test_binning_sums_charge_so_relative_noise_falls_with_its_side() -> None:
    noise = {}
    for binning in (1, 4):
        image = SensorModel(Sensor(), binning, PHOTONS_PER_S, 1).expose(
            flat(0.5), CameraSettings(0.02, 0.0, 12), 0
        )
        noise[binning] = image.std() / image.mean()
    assert noise[1] / noise[4] == pytest.approx(4, rel=0.05)


def test_noise_follows_from_seed_and_counter() -> None:
    def frame(seed: int, counter: int) -> bytes:
        model = SensorModel(Sensor(), 1, PHOTONS_PER_S, seed)
        return model.expose(flat(0.03), CameraSettings(0.02), counter).tobytes()

    assert frame(1, 0) == frame(1, 0)
    assert len({frame(1, 0), frame(1, 1), frame(2, 0)}) == 3


@pytest.mark.parametrize("irradiance", [0.0, 0.02, 0.4, 50.0])
@pytest.mark.parametrize("settings", [CameraSettings(0.02), CameraSettings(0.005, 6.0, 12)])
def test_expected_is_the_mean_of_frames(irradiance: float, settings: CameraSettings) -> None:
    model = SensorModel(Sensor(black_level=0.03), 4, PHOTONS_PER_S, 1)
    frames = np.stack([model.expose(flat(irradiance), settings, n) for n in range(4)]).astype(np.float64)
    level = model.expected(flat(irradiance), settings)
    assert level.dtype == np.float32
    assert frames.mean() == pytest.approx(
        level.mean(), abs=0.5 if frames.std() < 0.5 else 0.03 * frames.std()
    )


LEDS = {
    "red": {"lumens": 0.05, "wavelength_nm": 625},
    "green": {"lumens": 0.1, "wavelength_nm": 525},
    "blue": {"lumens": 0.02, "wavelength_nm": 460},
}


def lit(*names: str, **changes: Any) -> World:
    data = plain(projector={"leds": LEDS, "lit": list(names)}, **changes)
    data["materials"] = {"paint": {"reflectance": 0.9, "colour": [0.8, 0.4, 0.2]}}
    data["items"]["card"]["material"] = "paint"
    return config.validate(data, World, "world")


def test_a_camera_without_a_filter_sees_the_colour_of_the_light() -> None:
    """With one LED after the other, three frames of it have the colours of the part."""
    assert (colour_shares(lit("green"), "pillars") == 1.0).all()
    for name, share in zip(LEDS, (0.8, 0.4, 0.2), strict=True):
        np.testing.assert_allclose(colour_shares(lit(name), "card"), share)
    every = lit(*LEDS)
    assert 0.2 < colour_shares(every, "card")[0, 0] < 0.8
    parts = [colour_shares(every, "card", led)[0, 0] for led in LEDS]
    assert sum(parts) == pytest.approx(colour_shares(every, "card")[0, 0])
    whites = [colour_shares(every, "pillars", led)[0, 0] for led in LEDS]
    np.testing.assert_allclose(np.divide(parts, whites), (0.8, 0.4, 0.2), rtol=1e-6)


def test_pixels_of_a_filter_get_their_share_of_each_light() -> None:
    bayer = {"pattern": "GRBG", "red": [0.9, 0.1, 0.0], "green": [0.1, 0.8, 0.2], "blue": [0.0, 0.3, 0.7]}
    world = lit("green", camera={"bayer": bayer})
    corner = colour_shares(world, "pillars")[:2, :2]
    np.testing.assert_allclose(corner, [[0.8, 0.1], [0.3, 0.8]])
    np.testing.assert_allclose(colour_shares(world, "card")[:2, :2], 0.4 * corner)
