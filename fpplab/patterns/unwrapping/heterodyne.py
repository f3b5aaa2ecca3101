"""Heterodyne (multi-wavelength) temporal unwrapping, by beats of neighbouring sets and beats of those."""

import math
from collections.abc import Sequence
from itertools import pairwise

from fpplab.patterns.unwrapping.base import (
    NEGLIGIBLE,
    SyntheticWavelength,
    UnwrappingMethod,
    distinct_wavelengths,
    wavelength_differences,
)


class Heterodyne(UnwrappingMethod):
    """The sets and their beats, until one beat has at most one stripe."""

    name = "heterodyne"

    def wavelengths(self, sets: Sequence[SyntheticWavelength]) -> list[SyntheticWavelength]:
        # Beats of sets that are no neighbours are finer, and so nearer to the coarsest set.
        combined, level = [*sets, *wavelength_differences(sets)], list(sets)
        while level and min(w.stripes for w in level) > 1 + NEGLIGIBLE:
            level = sorted(level, key=lambda w: w.stripes)
            beats = (fine.beat(coarse) for coarse, fine in pairwise(level))
            level = [b for b in beats if b.stripes > NEGLIGIBLE]
            combined += level
        return distinct_wavelengths(combined)

    def advice(self, stripes: Sequence[float], coarsest: float, max_stripes: float) -> str:
        """Ask for sets whose beats reach one stripe."""
        step = max(2, round(math.sqrt(stripes[-1])))
        finest = max(stripes[-1], 2 * step)
        return (
            f"heterodyne unwrapping needs beats of neighbours that reach at most 1 stripe, and they stop at "
            f"{coarsest:g}; for example stripes {finest - 2 * step + 1:g}, {finest - step:g}, {finest:g} do"
        )
