"""The sensor: from irradiance to electrons to grey levels, with shot noise, read noise and saturation.

Photon transfer: a pixel with mean charge N electrons and gain K grey levels per electron has the variance
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
from sim.scene import GreyScale
from sim.world import Sensor, World

MANY_ELECTRONS = 1000.0
"""Charge from which shot noise is drawn as normal instead of Poisson; the neglected skewness is 3 %."""


@dataclass(frozen=True)
class SensorModel:
    """The sensor of a camera that sums the charge of `binning` x `binning` pixels.

    Attributes
    ----------
    sensor : Sensor
        Section of the world file.
    binning : int
        Pixels of the sensor along each side of a pixel of a frame.
    photons_per_s : float
        On an unbinned pixel that sees irradiance 1, see `sim.radiometry`.
    seed : int
        Of the noise.
    """

    sensor: Sensor
    binning: int
    photons_per_s: float
    seed: int

    @classmethod
    def of(cls, world: World) -> SensorModel:
        """Make the sensor of a world's camera.

        Parameters
        ----------
        world : World
            Camera, projector and seed.

        Returns
        -------
        SensorModel
            With the photon flux of that world's light.
        """
        camera = world.camera
        return cls(camera.sensor, camera.binning, white_photons_per_s(world), world.seed)

    def electrons(self, irradiance: float, exposure_s: float) -> float:
        """Compute the mean charge of a binned pixel, without saturation.

        Parameters
        ----------
        irradiance : float
            1 for a white surface that faces the white projector.
        exposure_s : float
            Exposure in s.

        Returns
        -------
        float
            In electrons.
        """
        per_pixel = self.photons_per_s * self.sensor.quantum_efficiency * exposure_s
        return irradiance * per_pixel * self.binning**2

    def gain(self, settings: CameraSettings) -> float:
        """Compute the system gain.

        Parameters
        ----------
        settings : CameraSettings
            Bit depth and gain.

        Returns
        -------
        float
            Grey levels per electron.
        """
        share = (1 - self.sensor.black_level) / (self.sensor.full_well_e * self.binning**2)
        return float(full_scale(settings.bits) * share * gain_factor(settings.gain_db))

    def expected(self, irradiance: NDArray[np.float32], settings: CameraSettings) -> NDArray[np.float32]:
        """Compute the mean of many frames: without noise, and without rounding.

        Parameters
        ----------
        irradiance : ndarray of float32
            Of any shape, 1 for white.
        settings : CameraSettings
            Exposure, gain and bit depth.

        Returns
        -------
        ndarray of float32
            Grey levels of the same shape, 0 to full scale.
        """
        return self.grey_scale(settings).levels(irradiance)

    def grey_scale(self, settings: CameraSettings) -> GreyScale:
        """Compute how mean grey levels follow from irradiance.

        Parameters
        ----------
        settings : CameraSettings
            Exposure, gain and bit depth.

        Returns
        -------
        GreyScale
            Of frames with these settings.
        """
        full, gain = full_scale(settings.bits), self.gain(settings)
        black = self.sensor.black_level * full
        most = black + gain * self.sensor.full_well_e * self.binning**2
        return GreyScale(black, gain * self.electrons(1.0, settings.exposure_s), min(most, float(full)), full)

    def expose(self, irradiance: NDArray[np.float32], settings: CameraSettings, counter: int) -> Image:
        """Expose one frame.

        Parameters
        ----------
        irradiance : ndarray of float32
            [v, u], 1 for white.
        settings : CameraSettings
            Exposure, gain and bit depth.
        counter : int
            Number of the frame; the noise follows from this and the seed.

        Returns
        -------
        Image
            Grey levels [v, u], uint8 up to 8 bits, otherwise uint16.
        """
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
    """Compute the photon flux on an unbinned pixel that sees irradiance 1.

    Parameters
    ----------
    world : World
        Its lamp, distance and lens determine the flux.

    Returns
    -------
    float
        Photons per second.
    """
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
        level = min(charge[i], full_well) * gain + black
        out[i] = int(min(max(level, 0.0), full_scale) + 0.5)
