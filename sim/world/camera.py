"""The camera of a world: sensor, shutter and lens."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from fpplab.calibration.model import Distortion
from fpplab.core.config import Document, Positive
from fpplab.core.geometry import Pinhole
from fpplab.patterns.mosaic import Bayer
from sim.world.numbers import NotNegative, PixelSize, Share

Binning = Literal[1, 2, 4, 8]  # pixels of the sensor along each side of a pixel of a frame


class Sensor(Document):
    """How light becomes grey levels, from a data sheet.

    Electrons are of the unbinned pixel; binning sums charge. Full scale at 0 dB is the full well.
    """

    full_well_e: Positive = 15000.0
    """Charge at which a pixel saturates, electrons."""
    read_noise_e: NotNegative = 2.5
    """Standard deviation of the read noise, electrons."""
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)] = 0.6
    """Electrons for each photon."""
    black_level: Annotated[float, Field(ge=0, lt=0.5)] = 0.01
    """Level without light, as a share of full scale."""
    bits: Annotated[tuple[Literal[8, 12], ...], Field(min_length=1)] = (8, 12)
    """Bit depths that frames can have."""
    exposure_s: tuple[Positive, Positive] = (20e-6, 10.0)
    """Least and greatest exposure, in s."""
    gain_db: tuple[float, float] = (0.0, 24.0)
    """Least and greatest gain, in dB."""

    @model_validator(mode="after")
    def _ranges_rise(self) -> Sensor:
        for name, (low, high) in (("exposure_s", self.exposure_s), ("gain_db", self.gain_db)):
            if low > high:
                raise ValueError(f"'{name}' is {[low, high]}: must be the minimum and the maximum")
        return self


class ShutterSection(Document):
    """When the rows of a frame are exposed."""

    line_time_s: Annotated[float, Field(ge=0, le=1e-2)] = 0.0
    """Delay of the exposure from one row of a frame to the next, in s; 0 for a global shutter."""


ByLight = tuple[Share, Share, Share]  # of red, green and blue light


class ColourFilter(Document):
    """The filter of a camera that sees colours: every pixel of a frame sees one."""

    pattern: Bayer
    """Colours of the first two pixels of the first row, and of the second row: RGGB, GRBG, GBRG or BGGR."""
    red: ByLight = (0.9, 0.1, 0.03)
    """Share of red, green and blue light that red pixels get."""
    green: ByLight = (0.1, 0.85, 0.2)
    """Share of red, green and blue light that green pixels get."""
    blue: ByLight = (0.03, 0.2, 0.8)
    """Share of red, green and blue light that blue pixels get."""


class CameraWorld(Document):
    """The simulated camera: sensor, shutter and lens."""

    sensor_size: PixelSize = (5472, 3648)
    """(width, height) of the sensor in unbinned pixels."""
    pixel_um: Positive = 2.4
    """Side of an unbinned pixel, in µm."""
    binning: Binning = 4
    """Pixels of the sensor along each side of a pixel of a frame."""
    focal_mm: Positive = 35.0
    """Distance from lens to sensor, in mm."""
    f_number: Annotated[float, Field(ge=0.7, le=64)] = 2.8
    """`focal_mm` over the diameter of the aperture."""
    transmission: Share = 0.9
    """Share of the light that passes the lens, 0 to 1."""
    focus_mm: Positive | None = None
    """Depth that is in focus, in mm; without it everything is."""
    vignetting: Annotated[float, Field(ge=0, le=40)] = 0.0
    """Exponent n of the falloff cosⁿ towards the edge of the image; 4 is natural vignetting."""
    centre_offset_px: tuple[float, float] = (0.0, 0.0)
    """Principal point minus the sensor's centre, in unbinned pixels."""
    distortion: Distortion = (0.0,) * 5
    """OpenCV's coefficients, five (k1 k2 p1 p2 k3) or eight."""
    shutter: ShutterSection = ShutterSection()
    """When the rows of a frame are exposed."""
    sensor: Sensor = Sensor()
    """How light becomes grey levels."""
    bayer: ColourFilter | None = None
    """Filter over the pixels; by default all see the same."""

    @model_validator(mode="after")
    def _binning_divides(self) -> CameraWorld:
        if any(side % self.binning for side in self.sensor_size):
            raise ValueError(
                f"'binning' is {self.binning}: it must divide the sensor's {list(self.sensor_size)}"
            )
        return self

    @model_validator(mode="after")
    def _focus_is_in_front(self) -> CameraWorld:
        if self.focus_mm is not None and self.focus_mm <= self.focal_mm:
            raise ValueError(
                f"'focus_mm' is {self.focus_mm:g}: must be greater than 'focal_mm', {self.focal_mm:g}"
            )
        return self

    @model_validator(mode="after")
    def _every_pixel_has_a_ray(self) -> CameraWorld:
        if not has_rays(self.model()):
            raise ValueError(
                f"'distortion' is {list(self.distortion)}: it folds or has a pole before the image's corner; "
                "must leave a ray to every pixel"
            )
        return self

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of a frame."""
        return self.sensor_size[0] // self.binning, self.sensor_size[1] // self.binning

    @property
    def aperture_mm(self) -> float:
        """Diameter of the aperture that blurs; 0 where everything is sharp."""
        return 0.0 if self.focus_mm is None else self.focal_mm / self.f_number

    def model(self) -> Pinhole:
        """Make the camera model in binned pixels."""
        focal = self.focal_mm * 1000 / self.pixel_um / self.binning
        centre = tuple(
            (side / 2 + offset) / self.binning - 0.5
            for side, offset in zip(self.sensor_size, self.centre_offset_px, strict=True)
        )
        return Pinhole.from_focal(self.size, (focal, focal), (centre[0], centre[1]), self.distortion)


def has_rays(camera: Pinhole) -> bool:
    """Return whether every camera pixel has a ray: its distortion neither folds nor has a pole in view."""
    width, height = camera.size
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) - 0.5
    return not np.isnan(camera.normalise(corners)).any()
