"""What surfaces are made of."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from fpplab.core.config import Document
from sim import scene
from sim.scene import Paint
from sim.world.numbers import Positive, Share


class Ridges(Document):
    """Sinusoidal ridges that tilt the surface but do not move it, such as the layers of a print.

    axis: across them, in the item's frame. period_mm: from ridge to ridge. depth_mm: from crest to valley.
    """

    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    period_mm: Positive = 0.2
    depth_mm: Annotated[float, Field(ge=0)] = 0.02

    @model_validator(mode="after")
    def _is_a_direction(self) -> Ridges:
        if not np.any(self.axis):
            raise ValueError("'axis' is zero: must be a direction")
        return self


class GrainSection(Document):
    """Random facets that tilt the surface.

    slope: root mean square of the surface's gradient, Sdq of ISO 25178-2. size_mm: square root of a facet's
    mean area.
    """

    slope: Annotated[float, Field(ge=0, le=1)] = 0.05
    size_mm: Positive = 0.2


class Diffuse(Document):
    """Matt paint. roughness: of Oren and Nayar's model in Fujii's form, 0 (Lambertian) to 1, the roughest."""

    kind: Literal["diffuse"] = "diffuse"
    reflectance: Share = 0.9
    roughness: Share = 0.0
    ridges: Ridges | None = None
    grain: GrainSection | None = None


class Glossy(Document):
    """A matt body under gloss.

    gloss: the share of the light that meets the gloss; the body has the rest. gloss_roughness: the square
    root of GGX's width, from nearly a mirror to matt.
    """

    kind: Literal["glossy"]
    reflectance: Share = 0.9
    roughness: Share = 0.0
    gloss: Share = 0.1
    gloss_roughness: Annotated[float, Field(ge=0.02, le=1)] = 0.3
    ridges: Ridges | None = None
    grain: GrainSection | None = None


class Translucent(Document):
    """A body that light enters, to leave it beside. radius_mm: mean free path between scatterings inside."""

    kind: Literal["translucent"]
    reflectance: Share = 0.9
    radius_mm: Positive = 0.5
    ridges: Ridges | None = None
    grain: GrainSection | None = None


KINDS = ("diffuse", "glossy", "translucent")


def _kind(material: Any) -> str | None:
    kind = material.get("kind", "diffuse") if isinstance(material, dict) else getattr(material, "kind", None)
    return kind if kind in KINDS else None


Material = Annotated[
    Annotated[Diffuse, Tag("diffuse")]
    | Annotated[Glossy, Tag("glossy")]
    | Annotated[Translucent, Tag("translucent")],
    Discriminator(
        _kind,
        custom_error_type="material",
        custom_error_message=f"must have a 'kind' of {', '.join(KINDS)}",
    ),
]


def paint(material: Material) -> Paint:
    """What the Blender process is told of a material."""
    if isinstance(material, Translucent):
        plain = Paint(material.reflectance, scatter_mm=material.radius_mm)
    elif isinstance(material, Glossy):
        plain = Paint(material.reflectance, material.roughness, material.gloss, material.gloss_roughness)
    else:
        plain = Paint(material.reflectance, material.roughness)
    return replace(plain, relief=_relief(material.ridges), grain=_grain(material.grain))


def _relief(ridges: Ridges | None) -> scene.Relief:
    if ridges is None:
        return scene.LEVEL
    x, y, z = (np.array(ridges.axis) / np.linalg.norm(ridges.axis)).tolist()
    return scene.Relief((x, y, z), ridges.period_mm, ridges.depth_mm)


def _grain(grain: GrainSection | None) -> scene.Grain:
    return scene.EVEN if grain is None else scene.Grain(grain.slope, grain.size_mm)
