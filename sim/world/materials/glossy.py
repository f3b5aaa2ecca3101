"""Matt paint under a gloss coat."""

from typing import Annotated, Literal

from pydantic import Field

from sim.scene import Paint, matt
from sim.world.materials.base import Material
from sim.world.materials.relief import GrainSection, Ridges, grain_of, relief_of
from sim.world.numbers import Share


class Glossy(Material):
    """A matt body under a gloss coat (GGX microfacets)."""

    kind: Literal["glossy"] = "glossy"
    """Name of the kind of material."""
    reflectance: Share = 0.9
    """Share of the light that the matt body reflects of what reaches it, 0 to 1."""
    roughness: Share = 0.0
    """Of the matt body: Oren and Nayar's model in Fujii's form, 0 (Lambertian) to 1 (roughest)."""
    gloss: Share = 0.1
    """Share of the light that meets the gloss coat, 0 to 1; the body gets the rest."""
    gloss_roughness: Annotated[float, Field(ge=0.02, le=1)] = 0.3
    """Square root of the width parameter of GGX, from nearly a mirror (0.02) to matt (1)."""
    ridges: Ridges | None = None
    """Sinusoidal ridges; None for none."""
    grain: GrainSection | None = None
    """Random facets; None for none."""

    def paint(self) -> Paint:
        return Paint(
            self.reflectance,
            matt(self.roughness),
            self.gloss,
            self.gloss_roughness,
            relief=relief_of(self.ridges),
            grain=grain_of(self.grain),
        )
