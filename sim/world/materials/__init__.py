"""What surfaces are made of: a module for every kind of material, found by listing this package.

A new material is one new file here, with a subclass of `Material` that has a ``kind`` of its own and a method
`Material.paint`. World files can name its kind from then on. Only where no existing shader can draw it, a new
one is added in `sim.blender.materials`.
"""

from typing import Annotated

from fpplab.core.tagged_union import TaggedUnion, import_members
from sim.world.materials.base import Material

import_members(__name__, __path__)

MaterialSection = Annotated[Material, TaggedUnion(default="diffuse")]
"""A material in a world file: of any kind, diffuse where it names none."""

__all__ = ["Material", "MaterialSection"]
