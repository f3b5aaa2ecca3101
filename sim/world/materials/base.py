"""The base class of all materials."""

from abc import abstractmethod
from typing import Any, ClassVar

from pydantic import Field

from fpplab.core import config
from fpplab.core.config import Document
from sim.part_surface import PartSurface
from sim.scene import Paint
from sim.world.numbers import Share


class Material(Document):
    """What a surface is made of: base class of the kinds of material that a world file can name.

    A subclass lies in a module of its own in this package and sets ``kind: Literal["name"] = "name"``.
    """

    subsurface: ClassVar[bool] = False
    """Whether light enters the surface and leaves it elsewhere, so that direct light alone is not enough."""

    kind: str
    """Name of the kind of material."""
    colour: tuple[Share, Share, Share] | None = None
    """Factors on its reflectance under red, green and blue light; by default it is grey."""
    sigma: dict[str, float] = Field(default_factory=dict)
    """Standard uncertainties of a surface that was matched to a scan, by field, in its unit."""

    @abstractmethod
    def paint(self) -> Paint:
        """Translate the material into what the Blender process needs to know of it.

        Called for every scene that is built with an item of this material.

        Returns
        -------
        Paint
            Plain numbers: base layer, gloss coat, ridges and grain.
        """


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
