"""The chain from lumens to electrons, against hand-computed light and a photon-transfer curve."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.devices import CameraSettings
from sim.sensor import (
    Led,
    SensorModel,
    gain_factor,
    irradiance_w_m2,
    lit_area_m2,
    photons_per_s,
    photopic_efficiency,
)
from sim.world import Sensor

GREEN = Led(lumens=100.0, wavelength_nm=525.0)
CIE_1924 = {
    450: 0.038, 460: 0.060, 470: 0.09098, 480: 0.13902, 490: 0.20802, 500: 0.323, 510: 0.503, 520: 0.710,
    525: 0.7932, 530: 0.862, 540: 0.954, 550: 0.99495, 555: 1.0, 560: 0.995, 570: 0.952, 580: 0.870,
    590: 0.757, 600: 0.631, 610: 0.503, 620: 0.381, 630: 0.265, 640: 0.175, 650: 0.107, 660: 0.061,
    680: 0.017, 700: 0.004102,
}  # fmt: skip


@pytest.mark.parametrize(("wavelength", "standard"), CIE_1924.items())
def test_photopic_efficiency_is_that_of_the_cie(wavelength: float, standard: float) -> None:
    """Within 0.008, and within 3 % where V is not small: what the fit is documented to reach."""
    fitted = photopic_efficiency(wavelength)
    assert abs(fitted - standard) < 0.008
    if 470 <= wavelength <= 650:
        assert fitted == pytest.approx(standard, rel=0.0301)


def test_hand_computed_chain() -> None:
    """100 lm of 525 nm over 400 x 250 mm, f/4, 90 %, 2.4 µm, with V = 0.7932 from the CIE's table:
    0.18459 W, 1.8459 W/m², 25.958 mW/m² on the sensor, 1.4952e-13 W on a pixel, 3.7837e-19 J a photon."""
    of_table = photopic_efficiency(525) / 0.7932
    assert GREEN.watts * of_table == pytest.approx(0.18459, rel=1e-4)
    area = lit_area_m2((800, 500), (1000.0, 1000.0), 500.0)
    assert area == pytest.approx(0.1)
    assert irradiance_w_m2(GREEN, area) * of_table == pytest.approx(1.8459, rel=1e-4)
    assert photons_per_s([GREEN], area, 4.0, 0.9, 2.4) * of_table == pytest.approx(395160, rel=1e-4)


def test_lens_collects_what_the_surface_sends_into_it() -> None:
    """From the surface's side: the pixel's footprint times radiance times the solid angle of the aperture."""
    focal, aperture, distance = 35e-3, 8.75e-3, 0.475
    image = focal * distance / (distance - focal)
    side = 2.4e-6 * distance / image
    solid_angle = math.pi * (aperture / 2) ** 2 / distance**2
    watts = irradiance_w_m2(GREEN, 0.1) / math.pi * side**2 * solid_angle * 0.9
    photon = 6.62607015e-34 * 299792458 / 525e-9
    assert photons_per_s([GREEN], 0.1, image / aperture, 0.9, 2.4) == pytest.approx(watts / photon, rel=1e-12)


def test_lit_area_is_that_between_the_outermost_rays() -> None:
    """A diamond lattice of 912 x 1140 mirrors, throw ratio 1.2, at 475 mm: 395.83 x 247.40 mm."""
    focal = 1.2 * 912
    assert lit_area_m2((912, 1140), (focal, 2 * focal), 475.0) == pytest.approx(0.39583 * 0.24740, rel=1e-4)


@given(factor=st.floats(0.1, 10), wavelength=st.floats(440, 660))
def test_proportions(factor: float, wavelength: float) -> None:
    def photons(
        lumens: float = 1, distance: float = 400, n: float = 4, tau: float = 0.05, p: float = 2
    ) -> float:
        area = lit_area_m2((800, 500), (1000.0, 900.0), distance)
        return photons_per_s([Led(lumens, wavelength)], area, n, tau, p)

    one = photons()
    assert photons(lumens=factor) == pytest.approx(factor * one)
    assert photons(tau=0.05 * factor) == pytest.approx(factor * one)
    assert photons(p=2 * factor) == pytest.approx(factor**2 * one)
    assert photons(distance=400 * factor) == pytest.approx(one / factor**2)
    assert photons(n=4 * factor) == pytest.approx(one / factor**2)


def test_light_of_several_colours_adds_up() -> None:
    leds = [Led(50, 460), GREEN, Led(80, 620)]
    apart = sum(photons_per_s([led], 0.1, 4, 0.9, 2.4) for led in leds)
    assert photons_per_s(leds, 0.1, 4, 0.9, 2.4) == pytest.approx(apart)
    assert photons_per_s([], 0.1, 4, 0.9, 2.4) == 0


@pytest.mark.parametrize(
    ("wavelength", "times"), [(460, 0.7932 / 0.060 * 460 / 525), (660, 0.7932 / 0.061 * 660 / 525)]
)
def test_a_lumen_of_a_colour_that_the_eye_hardly_sees_holds_many_photons(
    wavelength: float, times: float
) -> None:
    """By the CIE's values; the fit is 8 % off at either end."""
    photons = [photons_per_s([Led(1, w)], 0.1, 4, 0.9, 2.4) for w in (wavelength, 525.0)]
    assert photons[0] / photons[1] == pytest.approx(times, rel=0.09)


def test_gain_in_decibels_is_of_amplitudes() -> None:
    assert [gain_factor(db) for db in (0, 20, 40)] == pytest.approx([1, 10, 100])
    assert gain_factor(6.0206) == pytest.approx(2, rel=1e-6)


def sensor_model(photons: float, binning: int) -> SensorModel:
    """A sensor on whose unbinned pixels a white facing surface sends `photons` per second. Its read noise
    spans numbers also when binned, without which rounding would not have the variance 1/12."""
    return SensorModel(sensor=Sensor(read_noise_e=10.0), binning=binning, seed=5, photons_per_s=photons)


@pytest.mark.parametrize("binning", [1, 4])
def test_photon_transfer_curve_from_lumens(binning: int) -> None:
    """Variance against mean at 12 exposures, the variance from the difference of two frames.

    A variance of n differences has the relative standard error √(2/n), the mean of both frames σ/√(2n).
    """
    area = lit_area_m2((912, 1140), (1094.4, 2188.8), 475.0)
    photons = photons_per_s([Led(10, 460), GREEN, Led(35, 620)], area, 4.0, 0.9, 2.4)
    model = sensor_model(photons, binning)
    charge_per_s = photons * model.sensor.quantum_efficiency * binning**2
    read = model.sensor.read_noise_e * binning
    fullest = 0.9 * model.sensor.full_well_e * binning**2 / charge_per_s
    white = np.ones((300, 400), np.float32)
    error = 4 * np.sqrt(2 / white.size)
    assert error < 0.05

    means, variances = [], []
    for i, exposure in enumerate(np.linspace(0.0, fullest, 12)):
        settings = CameraSettings(float(exposure), 0.0, 12)
        first, second = (model.expose(white, settings, 2 * i + k).astype(np.float64) for k in (0, 1))
        means.append((first.mean() + second.mean()) / 2)
        variances.append((first - second).var() / 2)
        gain, electrons = model.gain(settings), charge_per_s * exposure
        expected = gain**2 * (electrons + read**2) + 1 / 12
        assert variances[-1] == pytest.approx(expected, rel=error)
        black = model.sensor.black_level * 4095
        level = black + gain * electrons
        assert abs(means[-1] - level) < 4 * np.sqrt(expected / (2 * white.size))

    weights = 1 / np.array(variances)
    slope, _ = np.polyfit(means, variances, 1, w=weights)
    assert slope == pytest.approx(model.gain(CameraSettings(fullest, 0.0, 12)), rel=error)
    assert means[-1] - means[0] == pytest.approx(0.9 * 4095 * (1 - model.sensor.black_level), rel=1e-3)
