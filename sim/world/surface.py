"""Materials of parts whose surface was matched to a scan."""

from __future__ import annotations

from typing import Any

from fpplab.core import config
from sim.part_surface import PartSurface
from sim.world.materials.base import Material

KEPT = {"diffuse": {"roughness", "ridges", "grain"}, "glossy": {"roughness", "ridges", "grain"}}
"""What a scan's brightness does not show and the part keeps, by kind of the new material."""
RELIEF = {"ridges", "grain"}


def with_surface(material: Material, surface: PartSurface) -> dict[str, Any]:
    """Give a part the surface that was matched; relief and roughness of its body stay as they were."""
    section = config.plain(material)
    kept = {name: section[name] for name in KEPT.get(surface.kind, RELIEF) if name in section}
    return {"kind": surface.kind, **kept, **surface.numbers(), "sigma": dict(surface.sigma)}


def surface_of(material: Material) -> PartSurface | None:
    if not material.sigma:
        return None
    names = {"reflectance", "gloss", "gloss_roughness", "radius_mm"}
    return PartSurface(
        **{name: value for name, value in config.plain(material).items() if name in names},
        sigma=material.sigma,
    )
