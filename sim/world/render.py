"""How a world's pictures are made."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from fpplab.core.config import Document

LightPath = Literal["transport", "linear", "reference"]
Subpixels = Annotated[int, Field(ge=1, le=8)]


class Render(Document):
    """How pictures are made.

    path: `transport` (direct light, any pattern by table), `linear` (a basis of the loaded patterns),
    `reference` (every pattern rendered), or `auto`: transport where all light is direct, else linear.
    subpixels: points of a pixel along each side; computed_subpixels: where light on flat items is computed,
    as many as `subpixels` unless told. samples: light paths for each of them; more than one matters to
    bounced light alone. bounces: between surfaces. device: what Cycles computes on.
    cache: keep tables of direct light on disk, for worlds that are met again.
    """

    path: Literal["auto", "transport", "linear", "reference"] = "auto"
    subpixels: Subpixels = 2
    computed_subpixels: Subpixels | None = None
    samples: Annotated[int, Field(ge=1, le=4096)] = 1
    bounces: Annotated[int, Field(ge=0, le=16)] = 0
    device: Literal["CPU", "CUDA", "OPTIX", "HIP", "METAL", "ONEAPI"] = "CPU"
    cache: bool = True


def shifts(subpixels: int) -> list[tuple[float, float]]:
    """Where in a pixel to look, relative to its centre: the middles of equal squares, in px."""
    steps = (np.arange(subpixels) + 0.5) / subpixels - 0.5
    return [(float(u), float(v)) for v in steps for u in steps]
