"""What every unwrapping method is: a way from a plan's fringe sets to synthetic wavelengths.

A synthetic wavelength is an integer combination of the measured wrapped phases, and so itself a wrapped
phase, of its own effective stripe count. Unwrapping begins with one of at most one stripe and goes on to the
finest set. A method is a file of this package with one class; its name in a plan file is the class's `name`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

NEGLIGIBLE = 1e-9  # stripe counts that differ by less are the same (chosen: more than rounding)


@dataclass(frozen=True)
class SyntheticWavelength:
    """One effective fringe."""

    coefficients: tuple[int, ...]  # of the wrapped phases of an axis' sets, fewest stripes first
    stripes: float  # periods of the combination across the projector

    def beat(self, coarser: SyntheticWavelength) -> SyntheticWavelength:
        """Subtract one with fewer stripes."""
        difference = zip(self.coefficients, coarser.coefficients, strict=True)
        return SyntheticWavelength(tuple(a - b for a, b in difference), self.stripes - coarser.stripes)

    @property
    def noise_gain(self) -> int:
        """By how much the variance of its phase exceeds that of one set."""
        return sum(c * c for c in self.coefficients)


def wavelength_differences(sets: Sequence[SyntheticWavelength]) -> list[SyntheticWavelength]:
    """Subtract every two that are not the same; fewest stripes come first in `sets`."""
    beats = (fine.beat(coarse) for coarse, fine in combinations(sets, 2))
    return [w for w in beats if w.stripes > NEGLIGIBLE]


def distinct_wavelengths(wavelengths: Sequence[SyntheticWavelength]) -> list[SyntheticWavelength]:
    """Sort by stripes; of equal ones keep that with fewest phases in it, which carries least noise."""
    ordered = sorted(wavelengths, key=lambda w: (w.stripes, -w.noise_gain))
    kept = [w for w, following in pairwise(ordered) if following.stripes - w.stripes > NEGLIGIBLE]
    return kept + ordered[-1:]


class UnwrappingMethod(ABC):
    """A way to unwrap the fringe sets of one axis, without any state."""

    name: str
    """What a plan calls it."""

    guided: bool = False
    """Whether it needs to know which projector coordinates a camera pixel may have."""

    spatial: bool = False
    """Whether neighbouring pixels unwrap a single set."""

    @abstractmethod
    def wavelengths(self, sets: Sequence[SyntheticWavelength]) -> list[SyntheticWavelength]:
        """Give every synthetic wavelength that unwrapping may pass through, once for each coded axis."""
        # sets: those of the axis, fewest stripes first; the wavelengths too, the finest set last, none twice

    @abstractmethod
    def advice(self, stripes: Sequence[float], coarsest: float, max_stripes: float) -> str:
        """Say what the method needs where its coarsest wavelength has too many stripes."""
        # It goes on after "… stripes: ", with counts that would do. The coarsest may have `max_stripes`: 1,
        # or more where the method is guided.
