"""The projector of a world: mirrors, lamp and lens."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from fpplab.calibration.model import Distortion, PoseFile
from fpplab.core.config import Document
from fpplab.core.conventions import Lattice
from fpplab.core.geometry import Pinhole
from sim.texture import MirrorTexture, least_blur
from sim.world.numbers import NotNegative, PixelSize, Positive, Share


class ResponseSection(Document):
    """Light from grey levels, both 0 … 1: `I_out = a I_in^g + b`.

    b is the black level, what closed mirrors leak: a device of contrast C has `b = (a + b) / C`.
    """

    a: Annotated[float, Field(gt=0, le=1)] = 1.0
    b: Share = 0.0
    g: Annotated[float, Field(ge=0.2, le=5)] = 1.0

    @model_validator(mode="after")
    def _white_is_one_at_most(self) -> ResponseSection:
        if self.a + self.b > 1 + 1e-9:
            raise ValueError(
                f"'a' + 'b' is {self.a + self.b:g}: at most 1, which is the brightest the lamp gives"
            )
        return self


class LedWorld(Document):
    """One colour of the lamp, at full white. Below 440 nm lumens say too little about light."""

    lumens: Positive
    wavelength_nm: Annotated[float, Field(ge=440, le=700)]


def _green() -> dict[str, LedWorld]:
    return {"green": LedWorld(lumens=120, wavelength_nm=525)}


class ProjectorWorld(Document):
    """The projector.

    throw_ratio: distance over image width. centre_px: principal point; far from the image's middle on a lens
    that throws upwards. T_camera_projector: its pose in the camera's frame, with the stage at 0.
    distance_mm: where a facing white surface has irradiance 1.
    leds: by colour; lit: those that are on. period_s: of the mirrors' switching, in which a pattern's binary
    planes are shown one after another; 0 is steady light.
    blur: standard deviation of the lens's point-spread at its sharpest, in mirrors. fill_factor: the share
    of its square that a mirror fills. focus_mm, aperture_mm: the depth that is sharp and the diameter of the
    lens, from which blur grows with the distance from focus; without a depth it does not.
    """

    size: PixelSize = (912, 1140)
    lattice: Lattice = Lattice.DIAMOND
    throw_ratio: Positive = 1.2
    centre_px: tuple[float, float] = (455.5, 1110.0)
    distortion: Distortion = (0.0,) * 5
    T_camera_projector: PoseFile
    distance_mm: Positive = 475.0
    leds: Annotated[dict[str, LedWorld], Field(min_length=1, default_factory=_green)]
    lit: Annotated[tuple[str, ...], Field(min_length=1)] = ("green",)
    period_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    response: ResponseSection = ResponseSection()
    blur: Annotated[float, Field(ge=0, le=20)] = 0.6
    fill_factor: Annotated[float, Field(ge=0.2, le=1)] = 1.0
    focus_mm: Positive | None = None
    aperture_mm: NotNegative = 10.0

    @model_validator(mode="after")
    def _blur_can_be_drawn(self) -> ProjectorWorld:
        least = least_blur(self.fill_factor)
        if 0 < self.blur < least:
            raise ValueError(f"'blur' is {self.blur:g}: must be 0 (ideal mirrors) or at least {least:.3f}")
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
        """The projector's pinhole; on the diamond lattice rows lie half as far apart as columns."""
        focal = self.throw_ratio * self.size[0]
        along_rows = 2 * focal if self.lattice is Lattice.DIAMOND else focal
        return Pinhole.from_focal(
            self.size, (focal, along_rows), self.centre_px, self.distortion, self.lattice
        )

    def texture(self) -> MirrorTexture:
        """Its mirrors as a texture."""
        return MirrorTexture(self.size, self.lattice, self.blur, self.fill_factor)
