"""The sensor: irradiance -> electrons -> numbers, with shot noise, read noise and saturation.

Photon transfer: a pixel with mean charge N electrons and gain K numbers per electron has the variance
`K² (N + read²) + 1/12` (Janesick, Photon Transfer, 2007; 1/12 for rounding).
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Image, full_scale, raw_dtype
from fpplab.devices import CameraSettings
from sim.radiometry import Led, gain_factor, lit_area_m2, photons_per_s
from sim.world import Sensor, World

MANY = 1000.0
"""Electrons from which a Poisson variable is drawn as a normal one; the skewness left out is 3 %."""


@dataclass(frozen=True)
class SensorModel:
    """The sensor of a camera that sums the charge of `binning` x `binning` pixels.

    photons_per_s: on an unbinned pixel that sees irradiance 1, see `sim.radiometry`.
    """

    sensor: Sensor
    binning: int
    photons_per_s: float
    seed: int

    @classmethod
    def of(cls, world: World) -> SensorModel:
        """The sensor of a world's camera."""
        camera = world.camera
        return cls(camera.sensor, camera.binning, white_photons_per_s(world), world.seed)

    def electrons(self, irradiance: float, exposure_s: float) -> float:
        """Mean charge of a binned pixel, without saturation."""
        per_pixel = self.photons_per_s * self.sensor.quantum_efficiency * exposure_s
        return irradiance * per_pixel * self.binning**2

    def gain(self, settings: CameraSettings) -> float:
        """Numbers per electron."""
        share = (1 - self.sensor.black_level) / (self.sensor.full_well_e * self.binning**2)
        return float(full_scale(settings.bits) * share * gain_factor(settings.gain_db))

    def expected(self, irradiance: NDArray[np.float32], settings: CameraSettings) -> NDArray[np.float32]:
        """The mean of many frames, float32 0 … full scale: without noise, and without rounding."""
        full = full_scale(settings.bits)
        most = np.float32(self.sensor.full_well_e * self.binning**2)
        numbers = irradiance * np.float32(self.electrons(1.0, settings.exposure_s))
        np.minimum(numbers, most, out=numbers)
        numbers *= np.float32(self.gain(settings))
        numbers += np.float32(self.sensor.black_level * full)
        return np.minimum(numbers, np.float32(full), out=numbers)

    def expose(self, irradiance: NDArray[np.float32], settings: CameraSettings, counter: int) -> Image:
        """One frame [v, u], uint8 up to 8 bits, else uint16; the noise follows from seed and counter."""
        random = np.random.Generator(np.random.SFC64([self.seed, counter]))
        charge = irradiance * np.float32(self.electrons(1.0, settings.exposure_s))
        read = self.sensor.read_noise_e * self.binning
        noise = random.standard_normal(charge.shape, np.float32)
        few = (charge > 0) & (charge < MANY)
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
    """Photons on an unbinned pixel that sees irradiance 1, by the lamp, the distance and the lens."""
    camera, projector = world.camera, world.projector
    focal = world.projector_model().matrix
    area = lit_area_m2(projector.size, (focal[0, 0], focal[1, 1]), projector.distance_mm)
    leds = [Led(projector.leds[n].lumens, projector.leds[n].wavelength_nm) for n in projector.lit]
    return photons_per_s(leds, area, camera.f_number, camera.transmission, camera.pixel_um)


@numba.njit(cache=True)
def _digitise(
    charge: NDArray[np.float32],
    full_well: float,
    gain: float,
    black: float,
    full_scale: int,
    out: Image,
) -> None:
    for i in range(charge.size):
        number = min(charge[i], full_well) * gain + black
        out[i] = int(min(max(number, 0.0), full_scale) + 0.5)
