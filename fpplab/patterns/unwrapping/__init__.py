"""Unwrapping methods, one file each; every file of this package is found by itself."""

from fpplab.core.tagged_union import concrete_subclasses, import_members
from fpplab.patterns.unwrapping.base import NEGLIGIBLE, SyntheticWavelength, UnwrappingMethod

import_members(__name__, __path__)


def unwrapping_methods() -> dict[str, UnwrappingMethod]:
    """List the unwrapping methods that a plan can name."""
    return {kind.name: kind() for kind in concrete_subclasses(UnwrappingMethod)}  # type: ignore[type-abstract]


__all__ = ["NEGLIGIBLE", "SyntheticWavelength", "UnwrappingMethod", "unwrapping_methods"]
