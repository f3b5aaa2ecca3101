"""Bodies that light enters."""

from typing import ClassVar, Literal

from fpplab.core.config import Positive
from sim.scene import BaseLayer, Paint
from sim.world.materials.base import Material
from sim.world.materials.relief import GrainSection, Ridges, grain_of, relief_of
from sim.world.numbers import Share


class Translucent(Material):
    """A body that light enters, is scattered in, and leaves next to where it entered."""

    subsurface: ClassVar[bool] = True

    kind: Literal["translucent"] = "translucent"
    """Name of the kind of material."""
    reflectance: Share = 0.9
    """Share of the light that comes out again, 0 to 1."""
    radius_mm: Positive = 0.5
    """Mean free path between scattering events inside, in mm."""
    ridges: Ridges | None = None
    """Sinusoidal ridges; None for none."""
    grain: GrainSection | None = None
    """Random facets; None for none."""

    def paint(self) -> Paint:
        return Paint(
            self.reflectance,
            BaseLayer("translucent", (("radius_mm", self.radius_mm),)),
            relief=relief_of(self.ridges),
            grain=grain_of(self.grain),
        )
