"""The base class of all materials."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from pydantic import Field

from fpplab.core.config import Document
from sim.scene import Paint


class Material(Document):
    """What a surface is made of: base class of the kinds of material that a world file can name.

    A subclass lies in a module of its own in this package and sets ``kind: Literal["name"] = "name"``.
    """

    subsurface: ClassVar[bool] = False
    """Whether light enters the surface and leaves it elsewhere, so that direct light alone is not enough."""

    kind: str
    """Name of the kind of material."""
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
