"""Products of a sinusoid and a finer carrier: every image is fine, so that coarse light adds nothing.

Source: Chen, Seidel and Lensch, "Modulated phase-shifting for 3D scanning", 2008.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from fpplab.core.conventions import Floats, phase_of_coordinate
from fpplab.patterns.fringe_sets.base import CodeSet

Shifts = Annotated[tuple[float, ...], Field(min_length=1, max_length=1000)]


class Modulated(CodeSet):
    """Images of `0.5 + 0.5 cos(Φ - shift) cos(Ψ - carrier shift)`, with the phases of sinusoid and carrier.

    Each phase is `2π stripes (u + 0.5)/W` with its own stripes. For every shift of the sinusoid all shifts of
    the carrier follow each other.
    """

    kind: Literal["modulated"] = "modulated"
    """`modulated`."""

    stripes: Annotated[float, Field(gt=0)]
    """Periods of the sinusoid across the whole projector along the axis."""

    shifts_deg: Shifts
    """Phase shifts of the sinusoid in degrees."""

    carrier_stripes: Annotated[float, Field(gt=0)]
    """Periods of the carrier."""

    carrier_shifts_deg: Shifts
    """Phase shifts of the carrier in degrees."""

    @property
    def images(self) -> int:
        return len(self.shifts_deg) * len(self.carrier_shifts_deg)

    def light(self, step: int, coordinate: Floats, length: int) -> Floats:
        """Give the product of both sinusoids about the middle of the range."""
        of_shift, of_carrier = divmod(step, len(self.carrier_shifts_deg))
        wave = np.cos(
            phase_of_coordinate(coordinate, self.stripes, length) - np.radians(self.shifts_deg[of_shift])
        )
        carrier = np.cos(
            phase_of_coordinate(coordinate, self.carrier_stripes, length)
            - np.radians(self.carrier_shifts_deg[of_carrier])
        )
        return np.asarray(0.5 + 0.5 * wave * carrier)

    def finest_stripes(self, length: int) -> float:
        """Give the stripes of the sum of both."""
        return self.stripes + self.carrier_stripes

    @property
    def short_name(self) -> str:
        return f"{self.stripes:g}of{self.carrier_stripes:g}"

    def fault(self, length: int) -> str | None:
        """Refuse a sum of both that the projector cannot resolve."""
        if self.finest_stripes(length) <= length / 2:
            return None
        return (
            f"carrier_stripes' is {self.carrier_stripes:g}: with {self.stripes:g} stripes more "
            f"than half of the projector's {length} pixels along {self.axis}"
        )
