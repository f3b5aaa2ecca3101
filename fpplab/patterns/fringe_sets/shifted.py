"""Sinusoids with listed shifts: of any number, from one image up, and of any values."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from fpplab.core.conventions import Floats, phase_of_coordinate
from fpplab.patterns.fringe_sets.base import CodeSet


class Shifted(CodeSet):
    """Images of `0.5 + 0.5 cos(2π stripes (u + 0.5)/W - shift)`, one for each shift.

    One set need not give a phase: all sets along an axis are decoded together. Several sets of neighbouring
    periods with a single image each, beside one of three, are micro phase shifting.
    """

    kind: Literal["shifted"] = "shifted"
    """`shifted`."""

    stripes: Annotated[float, Field(gt=0)]
    """Periods across the whole projector along the axis; may be fractional."""

    shifts_deg: Annotated[tuple[float, ...], Field(min_length=1, max_length=1000)]
    """Phase shift of each image in degrees; equal steps of three or more are a `sinusoid`."""

    @property
    def images(self) -> int:
        """How many images the set has."""
        return len(self.shifts_deg)

    def light(self, step: int, coordinate: Floats, length: int) -> Floats:
        """Give the sinusoid of the image."""
        phase = phase_of_coordinate(np.asarray(coordinate), self.stripes, length)
        return np.asarray(0.5 + 0.5 * np.cos(phase - np.radians(self.shifts_deg[step])))

    def waves(self, harmonics: int) -> Floats:
        """Give cosine and sine of every harmonic at every image, (N, 2 * harmonics)."""
        shift = np.outer(np.radians(self.shifts_deg), np.arange(1, harmonics + 1))
        return np.asarray(np.stack([np.cos(shift), np.sin(shift)], axis=-1).reshape(self.images, -1))

    @property
    def short_name(self) -> str:
        """Its stripes."""
        return f"{self.stripes:g}"

    def fault(self, length: int) -> str | None:
        """Refuse stripes that the projector cannot resolve."""
        if self.stripes <= length / 2:
            return None
        return (
            f"stripes' is {self.stripes:g}: at most {length / 2:g}, half of the projector's {length} pixels"
        )
