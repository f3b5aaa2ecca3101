"""The sensor: from irradiance to electrons to grey levels, with shot noise, read noise and saturation.

Photon transfer: a pixel with mean charge N electrons and gain K grey levels per electron has the variance
`K² (N + read²) + 1/12` (Janesick, Photon Transfer, 2007; 1/12 for rounding).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import constants

from fpplab.core.compiled import kernel
from fpplab.core.conventions import Image, Map, full_scale, raw_dtype
from fpplab.devices import CameraSettings
from fpplab.patterns.mosaic import colour_factors
from sim.scene import GreyScale
from sim.world import Sensor, World
from sim.world.projector import LedWorld

LUMENS_PER_WATT = 683.0  # luminous efficacy at the peak of V(λ), lm/W: the definition of the candela


@dataclass(frozen=True)
class Led:
    """Light of one colour."""

    lumens: float  # luminous flux out of the projector's lens under white
    wavelength_nm: float  # dominant wavelength in nm

    @property
    def watts(self) -> float:
        return self.lumens / (LUMENS_PER_WATT * photopic_efficiency(self.wavelength_nm))


def photopic_efficiency(wavelength_nm: float) -> float:
    """Compute V(λ), the photopic luminous efficiency function (CIE 1924)."""
    # Two lobes, each a Gaussian with different standard deviations on either side. It keeps within 0.008 of
    # the table: 3 % from 470 to 650 nm, 7 % at 460 and 660 nm, 13 % at 450 nm and 18 % at 440 nm. Below that
    # it fails: at 400 nm it gives three times too much.
    broad = 0.821 * _lobe(wavelength_nm, 568.8, 46.9, 40.5)
    green = 0.286 * _lobe(wavelength_nm, 530.9, 16.3, 31.1)
    return broad + green


def _lobe(wavelength: float, peak: float, below: float, above: float) -> float:
    sigma = below if wavelength < peak else above
    return math.exp(-0.5 * ((wavelength - peak) / sigma) ** 2)


def lit_area_m2(size: tuple[int, int], focal_px: tuple[float, float], distance_mm: float) -> float:
    """Compute the area that the projector's image covers on a surface that faces it."""
    # The principal point does not matter: it only moves the rectangle on a facing plane.
    # size (columns, rows); focal_px (fx, fy)
    width, height = (side / focal * distance_mm for side, focal in zip(size, focal_px, strict=True))
    return width * height * 1e-6


def irradiance_w_m2(led: Led, lit_area_m2: float) -> float:
    """Compute the irradiance of a facing surface over which the LED's light is spread evenly."""
    return led.watts / lit_area_m2


def photons_per_s(
    leds: Sequence[Led], lit_area_m2: float, f_number: float, transmission: float, pixel_um: float
) -> float:
    """Compute the photon flux on an unbinned pixel at a white Lambertian surface facing the projector."""
    share = transmission / (4 * f_number**2)
    area = (pixel_um * 1e-6) ** 2
    return sum(
        irradiance_w_m2(led, lit_area_m2) * share * area / _photon_energy(led.wavelength_nm) for led in leds
    )


def _photon_energy(wavelength_nm: float) -> float:
    """`h c / λ`, in J."""
    return float(constants.h * constants.c / (wavelength_nm * 1e-9))


def gain_factor(gain_db: float) -> float:
    return float(10 ** (gain_db / 20))


MANY_ELECTRONS = 1000.0
"""Charge from which shot noise is drawn as normal instead of Poisson; the neglected skewness is 3 %."""


@dataclass(frozen=True)
class SensorModel:
    """The sensor of a camera that sums the charge of `binning` x `binning` pixels."""

    sensor: Sensor  # section of the world file
    binning: int  # pixels of the sensor along each side of a pixel of a frame
    photons_per_s: float  # on an unbinned pixel that sees irradiance 1, see `sim.radiometry`
    seed: int  # of the noise

    @classmethod
    def of(cls, world: World) -> SensorModel:
        camera = world.camera
        return cls(camera.sensor, camera.binning, white_photons_per_s(world), world.seed)

    def electrons(self, irradiance: float, exposure_s: float) -> float:
        """Compute the mean charge of a binned pixel, without saturation."""
        per_pixel = self.photons_per_s * self.sensor.quantum_efficiency * exposure_s
        return irradiance * per_pixel * self.binning**2

    def gain(self, settings: CameraSettings) -> float:
        share = (1 - self.sensor.black_level) / (self.sensor.full_well_e * self.binning**2)
        return float(full_scale(settings.bits) * share * gain_factor(settings.gain_db))

    def expected(self, irradiance: NDArray[np.float32], settings: CameraSettings) -> NDArray[np.float32]:
        """Compute the mean of many frames: without noise, and without rounding."""
        return self.grey_scale(settings).levels(irradiance)

    def grey_scale(self, settings: CameraSettings) -> GreyScale:
        """Compute how mean grey levels follow from irradiance."""
        full, gain = full_scale(settings.bits), self.gain(settings)
        black = self.sensor.black_level * full
        saturated = black + gain * self.sensor.full_well_e * self.binning**2
        return GreyScale(
            black, gain * self.electrons(1.0, settings.exposure_s), min(saturated, float(full)), full
        )

    def expose(self, irradiance: NDArray[np.float32], settings: CameraSettings, counter: int) -> Image:
        random = np.random.Generator(np.random.SFC64([self.seed, counter]))
        charge = irradiance * np.float32(self.electrons(1.0, settings.exposure_s))
        read = self.sensor.read_noise_e * self.binning
        noise = random.standard_normal(charge.shape, np.float32)
        few = (charge > 0) & (charge < MANY_ELECTRONS)
        counted = random.poisson(charge[few]).astype(np.float32) + np.float32(read) * noise[few]
        full = full_scale(settings.bits)
        out = np.empty(charge.shape, raw_dtype(settings.bits))
        noise *= np.sqrt(charge + np.float32(read**2))
        charge += noise
        charge[few] = counted
        _digitise(
            charge.ravel(),
            self.sensor.full_well_e * self.binning**2,
            self.gain(settings),
            self.sensor.black_level * full,
            full,
            out.ravel(),
        )
        return out


def white_photons_per_s(world: World) -> float:
    """Compute the photon flux on an unbinned pixel that sees irradiance 1."""
    camera, projector = world.camera, world.projector
    focal = world.projector_model().matrix
    area = lit_area_m2(projector.size, (focal[0, 0], focal[1, 1]), projector.distance_mm)
    leds = [Led(projector.leds[n].lumens, projector.leds[n].wavelength_nm) for n in projector.lit]
    return photons_per_s(leds, area, camera.f_number, camera.transmission, camera.pixel_um)


def colour_shares(world: World, item: str, led: str | None = None) -> Map:
    """Share of an item's white light that each pixel gets, by the item's colour and the pixel's filter."""
    # led: the only one that is on
    # returns (height, width); the surroundings count as of the item's colour
    light, leds = np.zeros(3), world.projector.leds
    for name in world.projector.lit if led is None else (led,):
        light[int(np.searchsorted(_BORDERS_NM, -leds[name].wavelength_nm))] += _photons(leds[name])
    light /= sum(_photons(leds[name]) for name in world.projector.lit)
    if item in world.items and (colour := world.material_of(item).colour):
        light = light * np.array(colour)
    shape, bayer = world.camera.size[::-1], world.camera.bayer
    if bayer is None:
        return np.full(shape, light.sum(), np.float32)
    red, green, blue = (float(light @ part) for part in (bayer.red, bayer.green, bayer.blue))
    return colour_factors(shape, bayer.pattern, (red, green, blue))


def _photons(led: LedWorld) -> float:
    return Led(led.lumens, led.wavelength_nm).watts * led.wavelength_nm


_BORDERS_NM = (-585.0, -490.0)  # between red, green and blue light, falling


@kernel()
def _digitise(
    charge: NDArray[np.float32], full_well: float, gain: float, black: float, full_scale: int, out: Image
) -> None:
    for i in range(charge.size):
        level = min(charge[i], full_well) * gain + black
        out[i] = int(min(max(level, 0.0), full_scale) + 0.5)
