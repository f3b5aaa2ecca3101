"""Falloff of the projector: how much light each mirror gets, relative to the middle of the image."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Lattice, mirror_centres
from sim.world import ProjectorWorld

LEAST = 0.01
"""Share of the light that every mirror gets: a polynomial may fall below zero, light does not."""


def projector_falloff(projector: ProjectorWorld) -> NDArray[np.float32] | None:
    """Compute the light of every mirror."""
    # returns (rows, columns)
    if not any(projector.falloff):
        return None
    return _field(projector.size, projector.lattice, projector.falloff)


@lru_cache(maxsize=8)
def _field(size: tuple[int, int], lattice: Lattice, coefficients: tuple[float, ...]) -> NDArray[np.float32]:
    u, v = mirror_centres(size, lattice)
    half = 0.5 * size[0]
    rows_per_column = 2.0 if lattice is Lattice.DIAMOND else 1.0
    x = (u - 0.5 * (size[0] - 1)) / half
    y = (v - 0.5 * (size[1] - 1)) / (rows_per_column * half)
    terms = (x, y, x * x, x * y, y * y)
    light = 1.0 + sum(c * term for c, term in zip(coefficients, terms, strict=True))
    return np.maximum(light, LEAST).astype(np.float32)
