"""The projector of a world: mirrors, lamp and lens."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from fpplab.calibration.model import Distortion, PoseFile
from fpplab.core.config import Document, Positive
from fpplab.core.conventions import Lattice
from fpplab.core.geometry import Pinhole
from fpplab.patterns.curve import Curve
from sim.effects import ProjectorEffects
from sim.mirror_spread import MIN_BLUR
from sim.texture import MirrorTexture
from sim.world.numbers import NotNegative, PixelSize, Share


class ResponseSection(Curve):
    """The projector's response, light from grey levels, both 0 to 1: `I_out = a S(I_in) + b`."""

    a: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Light of white above black."""
    b: Share = 0.0
    """Black level, the light that leaks from closed mirrors: `b = (a + b) / C` for contrast C."""
    g: Annotated[float, Field(ge=0.2, le=5)] = 1.0
    """Exponent (gamma): S is `I_in^g`, where there is no spline."""

    @model_validator(mode="after")
    def _white_is_one_at_most(self) -> ResponseSection:
        if self.a + self.b > 1 + 1e-9:
            raise ValueError(
                f"'a' + 'b' is {self.a + self.b:g}: at most 1, which is the brightest the lamp gives"
            )
        return self


class LedWorld(Document):
    """One colour of the lamp.

    Below 440 nm the luminous flux does not determine the radiant flux well enough.
    """

    lumens: Positive
    """Luminous flux out of the projector's lens under white, in lm."""
    wavelength_nm: Annotated[float, Field(ge=440, le=700)]
    """Dominant wavelength, in nm."""


def _green() -> dict[str, LedWorld]:
    return {"green": LedWorld(lumens=120, wavelength_nm=525)}


class ProjectorDevice(Document):
    """Mirrors, lamp and lens without effects."""

    size: PixelSize = (912, 1140)
    """(columns, rows) of mirrors."""
    lattice: Lattice = Lattice.DIAMOND
    """How the mirrors are arranged."""
    throw_ratio: Positive = 1.2
    """Distance over image width."""
    centre_px: tuple[float, float] = (455.5, 1110.0)
    """Principal point, in mirrors; far from the image's middle for a lens with vertical offset."""
    distortion: Distortion = (0.0,) * 5
    """OpenCV's coefficients, five (k1 k2 p1 p2 k3) or eight."""
    T_camera_projector: PoseFile
    """Pose of the projector in the camera's frame, with the stage at 0."""
    distance_mm: Positive = 475.0
    """Distance at which a white surface that faces the projector has irradiance 1, in mm."""
    leds: Annotated[dict[str, LedWorld], Field(min_length=1, default_factory=_green)]
    """The lamp's LEDs, by name of their colour."""
    lit: Annotated[tuple[str, ...], Field(min_length=1)] = ("green",)
    """Names of the LEDs that are on."""
    period_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Period in which a pattern's binary planes are shown one after another, in s; 0 for steady light."""
    response: ResponseSection = ResponseSection()
    """Light from grey levels."""
    blur: Annotated[float, Field(ge=0, le=20)] = 0.6
    """Standard deviation of the lens's point spread in focus, in mirrors; 0 for ideal sharp mirrors."""
    fill_factor: Annotated[float, Field(ge=0.2, le=1)] = 1.0
    """Share of its square that a mirror fills."""
    focus_mm: Positive | None = None
    """Depth that is in focus, in mm; None for the same blur at every depth."""
    aperture_mm: NotNegative = 10.0
    """Diameter of the lens in mm, by which blur grows with the distance from focus."""


class ProjectorWorld(ProjectorEffects, ProjectorDevice):
    """The simulated projector: mirrors, lamp and lens."""

    @model_validator(mode="after")
    def _blur_can_be_drawn(self) -> ProjectorWorld:
        if 0 < self.blur < MIN_BLUR:
            raise ValueError(f"'blur' is {self.blur:g}: must be 0 (ideal mirrors) or at least {MIN_BLUR:g}")
        if self.blur == 0 and self.focus_mm is not None:
            raise ValueError("'blur' is 0, ideal mirrors, which have no 'focus_mm': remove one of the two")
        return self

    @model_validator(mode="after")
    def _lit_leds_are_there(self) -> ProjectorWorld:
        for name in self.lit:
            if name not in self.leds:
                raise ValueError(f"'lit' names '{name}': must be of 'leds', which are {', '.join(self.leds)}")
            if self.lit.count(name) > 1:
                raise ValueError(f"'lit' names '{name}' more than once: must name a colour once")
        return self

    def model(self) -> Pinhole:
        """Make the projector model; on the diamond lattice rows lie half as far apart as columns."""
        focal = self.throw_ratio * self.size[0]
        along_rows = 2 * focal if self.lattice is Lattice.DIAMOND else focal
        return Pinhole.from_focal(
            self.size, (focal, along_rows), self.centre_px, self.distortion, self.lattice
        )

    def texture(self) -> MirrorTexture:
        return MirrorTexture(self.size, self.lattice, self.blur, self.fill_factor)
