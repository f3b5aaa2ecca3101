"""Sinusoids with listed shifts: of any number, from one image up, and of any values."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from fpplab.core.conventions import Floats
from fpplab.patterns.fringe_sets.base import PeriodicSet


class Shifted(PeriodicSet):
    """Images of `0.5 + 0.5 cos(2π stripes (u + 0.5)/W - shift)`, one for each shift.

    One set need not give a phase: all sets along an axis are decoded together. Several sets of neighbouring
    periods with a single image each, beside one of three, are micro phase shifting.
    """

    kind: Literal["shifted"] = "shifted"
    """`shifted`."""

    shifts_deg: Annotated[tuple[float, ...], Field(min_length=1, max_length=1000)]
    """Phase shift of each image in degrees; equal steps of three or more are a `sinusoid`."""

    @property
    def images(self) -> int:
        return len(self.shifts_deg)

    def phase_shifts(self) -> Floats:
        """Give the listed shifts, (N,) rad."""
        return np.radians(self.shifts_deg)

    def wave(self, phase: Floats, step: int) -> Floats:
        """Give `0.5 + 0.5 cos(Φ - shift)`."""
        return np.asarray(0.5 + 0.5 * np.cos(phase - np.radians(self.shifts_deg[step])))
