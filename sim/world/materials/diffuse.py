"""Matt paint."""

from typing import Literal

from sim.scene import Paint, matt
from sim.world.materials.base import Material
from sim.world.materials.relief import GrainSection, Ridges, grain_of, relief_of
from sim.world.numbers import Share


class Diffuse(Material):
    """Matt paint: Lambertian, or rough after Oren and Nayar."""

    kind: Literal["diffuse"] = "diffuse"
    """Name of the kind of material."""
    reflectance: Share = 0.9
    """Share of the light that is reflected, 0 to 1."""
    roughness: Share = 0.0
    """Of Oren and Nayar's model in Fujii's form, 0 (Lambertian) to 1 (roughest)."""
    ridges: Ridges | None = None
    """Sinusoidal ridges; None for none."""
    grain: GrainSection | None = None
    """Random facets; None for none."""

    def paint(self) -> Paint:
        return Paint(
            self.reflectance, matt(self.roughness), relief=relief_of(self.ridges), grain=grain_of(self.grain)
        )
