"""The camera of a world: sensor, shutter and lens."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from fpplab.calibration.model import Distortion
from fpplab.core.config import Document
from fpplab.core.geometry import Pinhole
from sim.world.numbers import NotNegative, PixelSize, Positive, Share

Binning = Literal[1, 2, 4, 8]
"""Pixels of the sensor along each side of a pixel of a frame."""


class Sensor(Document):
    """How light becomes numbers, from a data sheet. Electrons are of the UNBINNED pixel; binning sums charge.

    read_noise_e: standard deviation, electrons. black_level: what no light gives, share of full scale.
    Full scale at 0 dB is the full well.
    """

    full_well_e: Positive = 15000.0
    read_noise_e: NotNegative = 2.5
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)] = 0.6
    black_level: Annotated[float, Field(ge=0, lt=0.5)] = 0.01
    bits: Annotated[tuple[Literal[8, 12], ...], Field(min_length=1)] = (8, 12)
    exposure_s: tuple[Positive, Positive] = (20e-6, 10.0)
    gain_db: tuple[float, float] = (0.0, 24.0)

    @model_validator(mode="after")
    def _ranges_rise(self) -> Sensor:
        for name, (low, high) in (("exposure_s", self.exposure_s), ("gain_db", self.gain_db)):
            if low > high:
                raise ValueError(f"'{name}' is {[low, high]}: must be the least and the greatest")
        return self


class ShutterSection(Document):
    """When rows expose. line_time_s: from one row of a frame to the next; 0 is a global shutter."""

    line_time_s: Annotated[float, Field(ge=0, le=1e-2)] = 0.0


class CameraWorld(Document):
    """The camera.

    focal_mm: from lens to sensor. centre_offset_px: principal point minus the sensor's centre, in unbinned
    pixels. f_number: `focal_mm` over the diameter of the aperture. transmission: of the lens. focus_mm: the
    depth that is sharp; without it everything is. vignetting: exponent n of the loss cosⁿ towards the edge;
    4 is the natural one.
    """

    sensor_size: PixelSize = (5472, 3648)
    pixel_um: Positive = 2.4
    binning: Binning = 4
    focal_mm: Positive = 35.0
    f_number: Annotated[float, Field(ge=0.7, le=64)] = 2.8
    transmission: Share = 0.9
    focus_mm: Positive | None = None
    vignetting: Annotated[float, Field(ge=0, le=40)] = 0.0
    centre_offset_px: tuple[float, float] = (0.0, 0.0)
    distortion: Distortion = (0.0,) * 5
    shutter: ShutterSection = ShutterSection()
    sensor: Sensor = Sensor()

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
        """The camera of the binned pixels."""
        focal = self.focal_mm * 1000 / self.pixel_um / self.binning
        centre = tuple(
            (side / 2 + offset) / self.binning - 0.5
            for side, offset in zip(self.sensor_size, self.centre_offset_px, strict=True)
        )
        return Pinhole.from_focal(self.size, (focal, focal), (centre[0], centre[1]), self.distortion)


def has_rays(camera: Pinhole) -> bool:
    """Whether every pixel of a camera sees somewhere: its distortion neither folds nor has a pole in view."""
    width, height = camera.size
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) - 0.5
    return not np.isnan(camera.normalise(corners)).any()
