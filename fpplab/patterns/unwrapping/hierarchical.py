"""Hierarchical (multi-frequency) temporal unwrapping: each set says which period of the next is meant."""

import math
from collections.abc import Sequence

from fpplab.patterns.unwrapping.base import SyntheticWavelength, UnwrappingMethod


class Hierarchical(UnwrappingMethod):
    """The sets themselves, from one of at most one stripe to the finest."""

    name = "hierarchical"

    def wavelengths(self, sets: Sequence[SyntheticWavelength]) -> list[SyntheticWavelength]:
        return list(sets)

    def advice(self, stripes: Sequence[float], coarsest: float, max_stripes: float) -> str:
        """Ask for a set of at most one stripe."""
        return (
            f"hierarchical unwrapping needs a set of at most 1 stripe, and the fewest here is {coarsest:g}; "
            f"add one, for example stripes 1, {math.sqrt(stripes[-1]):.3g}, {stripes[-1]:g}"
            + (
                "; of images that are there already, neighbours determine the orders: 'spatial'"
                if len(stripes) == 1
                else ""
            )
        )
