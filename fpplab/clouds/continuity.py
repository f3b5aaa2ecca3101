"""Whether two points lie on one surface: the rule, in inverse depth over the slopes of the rays.

Two points lie on one surface when the step in depth between them is no more than a surface
inclined by `STEEPEST_DEG` to the image plane would show over the footprint that separates
their rays at that depth, plus `NOISE_SIGMAS` standard deviations of the step's own noise.
A longer step is a jump from one surface to another. In w = 1/z over the slopes (a, b) the rule reads
`|Δw| <= w (tan(STEEPEST) |Δ(a, b)| + NOISE_SIGMAS σ(Δz)/z)`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

STEEPEST_DEG = 80.0
"""Greatest inclination of a surface to the image plane."""
NOISE_SIGMAS = 4.0
"""Standard deviations of noise that are allowed in a step within one surface."""

_STEEPEST = np.float32(np.tan(np.radians(STEEPEST_DEG)))


@njit(inline="always")
def is_continuous(da: float, db: float, dw: float, w: float, noise: float) -> bool:
    """Decide whether two points lie on one surface, by the rule of this module."""
    return bool(abs(dw) <= w * (_STEEPEST * np.sqrt(da * da + db * db) + noise))
