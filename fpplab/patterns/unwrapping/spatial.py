"""Spatial unwrapping: neighbouring pixels say how the phase of a single set goes on."""

from collections.abc import Sequence

from fpplab.patterns.unwrapping.base import SyntheticWavelength, UnwrappingMethod


class Spatial(UnwrappingMethod):
    """The one set of an axis; which of its periods an island of pixels shows, geometry may tell."""

    name = "spatial"
    spatial = True

    def wavelengths(self, sets: Sequence[SyntheticWavelength]) -> list[SyntheticWavelength]:
        return list(sets[-1:])

    def advice(self, stripes: Sequence[float], coarsest: float, max_stripes: float) -> str:
        """Refuse further sets, which tell orders better."""
        return "spatial unwrapping takes one set along one axis; 'hierarchical' or 'heterodyne' take several"
