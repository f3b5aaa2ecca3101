"""How pictures of a world are rendered."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from fpplab.core.config import Document

LightPath = Literal["transport", "linear", "reference"]  # how patterns become pictures, see `sim.light.light`

Subpixels = Annotated[int, Field(ge=1, le=8)]  # points of a pixel along each side


class Render(Document):
    """How pictures are rendered."""

    path: Literal["auto", "transport", "linear", "reference"] = "auto"
    """`transport` (direct light, any pattern by look-up), `linear` (a basis of the loaded patterns is
    rendered), `reference` (every pattern is rendered), or `auto`: transport where all light is direct,
    otherwise linear."""
    subpixels: Subpixels = 2
    """Points of a pixel along each side."""
    computed_subpixels: Subpixels | None = None
    """The same where light on flat items is computed instead of rendered; None for `subpixels`."""
    samples: Annotated[int, Field(ge=1, le=4096)] = 1
    """Light paths for each sub-pixel; more than one matters to indirect light only."""
    bounces: Annotated[int, Field(ge=0, le=16)] = 0
    """Reflections between surfaces that are followed; 0 for direct light only."""
    device: Literal["CPU", "CUDA", "OPTIX", "HIP", "METAL", "ONEAPI"] = "CPU"
    """What Cycles computes on."""
    cache: bool = True
    """Whether tables of direct light are kept on disk, for worlds that are used again."""


def subpixel_shifts(subpixels: int) -> list[tuple[float, float]]:
    """List the points of a pixel that are looked through: the middles of equal squares."""
    # returns (float, float) px
    steps = (np.arange(subpixels) + 0.5) / subpixels - 0.5
    return [(float(u), float(v)) for v in steps for u in steps]
