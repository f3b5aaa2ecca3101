"""What a world shows besides devices and items: the surroundings, such as a table and a wall."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from fpplab.core import config
from fpplab.core.config import Document
from sim.world.items import FileName


class SurroundingsSection(Document):
    """Matt surfaces that stand still whatever the fixture holds, as a bench's recordings show them."""

    mesh: FileName
    """STL, PLY or OBJ file in mm in the camera's frame."""
    picture: FileName
    """Grey image of their reflectance as the camera sees it, from 0 to `reflectance` at white."""
    reflectance: Annotated[float, Field(gt=0, le=1)]
    """Reflectance of what is white in the picture, 0 to 1."""

    def beside(self, folder: Path) -> SurroundingsSection:
        """Make the names of files absolute that lie in a folder."""
        names = {
            name: config.resolve_relative_to(getattr(self, name), folder) for name in ("mesh", "picture")
        }
        return self.model_copy(update=names)

    def relative_to(self, folder: Path) -> SurroundingsSection:
        """Make the names of files relative that lie in a folder."""
        named = {name: Path(getattr(self, name)) for name in ("mesh", "picture")}
        inside = {name: path.name for name, path in named.items() if path.parent == folder.resolve()}
        return self.model_copy(update=inside)
