"""Geometry-guided unwrapping: calibration and depth range say which coordinates a camera pixel may have."""

from collections.abc import Sequence

from fpplab.patterns.unwrapping.base import (
    NEGLIGIBLE,
    SyntheticWavelength,
    UnwrappingMethod,
    distinct_wavelengths,
    wavelength_differences,
)


class Guided(UnwrappingMethod):
    """The sets, and where these are too fine their differences, until one period spans the interval.

    A camera pixel sees the projector along an epipolar segment between the nearest and the farthest depth.
    The coarsest wavelength needs one period for that segment, not for the whole projector.
    """

    name = "guided"
    guided = True

    def wavelengths(self, sets: Sequence[SyntheticWavelength]) -> list[SyntheticWavelength]:
        coarser = [d for d in wavelength_differences(sets) if d.stripes < sets[0].stripes - NEGLIGIBLE]
        return [*distinct_wavelengths(coarser), *sets]

    def advice(self, stripes: Sequence[float], coarsest: float, max_stripes: float) -> str:
        """Ask for a coarser set or a narrower range of depths."""
        return (
            f"guided unwrapping in this depth range needs a set, or a difference of two, of at most "
            f"{max_stripes:.3g} stripes, and the coarsest here is {coarsest:g}; add one or narrow the "
            "depth range" + ("; or take orders from neighbours: 'spatial'" if len(stripes) == 1 else "")
        )
