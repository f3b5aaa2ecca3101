"""Relief that any material can have: ridges and grain, which tilt the surface without moving it."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from fpplab.core.config import Document, Positive
from sim import scene


class Ridges(Document):
    """Sinusoidal ridges that tilt the surface but do not move it, such as the layers of a print."""

    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Direction across the ridges, in the item's frame; of any length but zero."""
    period_mm: Positive = 0.2
    """Distance from ridge to ridge, in mm."""
    depth_mm: Annotated[float, Field(ge=0)] = 0.02
    """Height from valley to crest, in mm."""

    @model_validator(mode="after")
    def _is_a_direction(self) -> Ridges:
        if not np.any(self.axis):
            raise ValueError("'axis' is zero: must be a direction")
        return self


class GrainSection(Document):
    """Random facets that tilt the surface."""

    slope: Annotated[float, Field(ge=0, le=1)] = 0.05
    """Root mean square of the surface's gradient, Sdq of ISO 25178-2."""
    size_mm: Positive = 0.2
    """Square root of a facet's mean area, in mm."""


def relief_of(ridges: Ridges | None) -> scene.Relief:
    if ridges is None:
        return scene.NO_RELIEF
    x, y, z = (np.array(ridges.axis) / np.linalg.norm(ridges.axis)).tolist()
    return scene.Relief((x, y, z), ridges.period_mm, ridges.depth_mm)


def grain_of(grain: GrainSection | None) -> scene.Grain:
    return scene.NO_GRAIN if grain is None else scene.Grain(grain.slope, grain.size_mm)
