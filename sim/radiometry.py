"""Radiometry in SI units, from the lumens of a projector to the photons on a pixel of the camera.

    Φ_v     lumens of one LED, as the projector's data sheet gives them
    Φ = Φ_v / (683 lm/W V(λ))       radiant flux, W                          (`Led.watts`)
    E = Φ / A                       irradiance of a facing surface, W/m²     (`irradiance_w_m2`)
    L = E / π                       radiance of a white Lambertian surface, W/(m² sr)
    E' = τ π L / (4 N²) = τ E / (4 N²)      irradiance of the sensor, W/m²
    n = E' p² λ / (h c)             photons per second on a pixel of side p  (`photons_per_s`)

The sensor's quantum efficiency then makes electrons of photons.

The step to the sensor: seen from a pixel on the axis, the lens's aperture of diameter D is a disc of radiance
τ L at the image distance s'. Its rim lies at an angle θ' with tan θ' = D / (2 s'), and a disc of even
radiance gives E' = π τ L sin²θ'. With the working f-number N = s' / D that is π τ L / (4 N² + 1), and a lens
free of coma (Abbe's sine condition, sin θ' = 1 / (2 N)) gives π τ L / (4 N²), which is used here. The two
differ by 1/(4 N²), 3 % at f/2.8 and 0.4 % at f/8. N belongs to the image distance; the number engraved on a
lens is that for infinity, focal length over D, and N exceeds it by the factor 1 + magnification.

Not included: the fall of light with the fourth power of the cosine away from the camera's axis,
the width of an LED's spectrum, and any unevenness over the projected image.

Sources: CIE 018:2019 for lumens; Born & Wolf, Principles of Optics, 7th ed., 4.8, for the lens; Wyman, Sloan
& Shirley (2013) for V(λ).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from scipy import constants

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
