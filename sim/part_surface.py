"""What the surface of a part does to light, as it is matched to a scan and given to a simulation."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class PartSurface:
    """A matt or translucent body under a gloss coat."""

    reflectance: float  # share of the light that the body reflects of what reaches it, 0 to 1
    gloss: float = 0.0  # share of the light that meets the gloss coat, 0 to 1; 0 for no coat
    gloss_roughness: float = 0.3  # square root of the width parameter of GGX, of the coat
    radius_mm: float = 0.0  # mean free path of light in the body in mm
    sigma: Mapping[str, float] = field(default_factory=dict)  # standard uncertainties by attribute

    @property
    def kind(self) -> str:
        """Name of the kind of material: `diffuse`, `glossy` or `translucent`."""
        if self.radius_mm > 0:
            return "translucent"
        return "glossy" if self.gloss > 0 else "diffuse"

    @property
    def relative_sigma(self) -> float:
        """Standard uncertainty of the reflectance, relative to it; 0 where it is not stated."""
        return self.sigma.get("reflectance", 0.0) / max(self.reflectance, 1e-6)

    def numbers(self) -> dict[str, float]:
        further = {"glossy": ("gloss", "gloss_roughness"), "translucent": ("radius_mm",)}
        return {name: getattr(self, name) for name in ("reflectance", *further.get(self.kind, ()))}

    def summary(self) -> dict[str, Any]:
        return {"kind": self.kind, **self.numbers(), "sigma": dict(self.sigma)}
