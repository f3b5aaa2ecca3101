"""Hierarchical (multi-frequency) temporal unwrapping: each set says which period of the next is meant."""

from __future__ import annotations

import math
from collections.abc import Sequence

from fpplab.patterns.unwrapping.base import SyntheticWavelength, UnwrappingMethod


class Hierarchical(UnwrappingMethod):
    """The sets themselves, from one of at most one stripe to the finest."""

    name = "hierarchical"

    def wavelengths(self, sets: Sequence[SyntheticWavelength]) -> list[SyntheticWavelength]:
        """Give the sets as they are.

        Parameters
        ----------
        sets : sequence of SyntheticWavelength
            The fringe sets of the axis, fewest stripes first.

        Returns
        -------
        list of SyntheticWavelength
            The same.
        """
        return list(sets)

    def advice(self, stripes: Sequence[float], coarsest: float, most: float) -> str:
        """Ask for a set of at most one stripe.

        Parameters
        ----------
        stripes : sequence of float
            Of the axis' sets, fewest first.
        coarsest : float
            Stripes of the coarsest set.
        most : float
            Stripes that it may have, 1.

        Returns
        -------
        str
            What is needed, with an example.
        """
        return (
            f"hierarchical unwrapping needs a set of at most 1 stripe, and the fewest here is {coarsest:g}; "
            f"add one, for example stripes 1, {math.sqrt(stripes[-1]):.3g}, {stripes[-1]:g}"
        )
