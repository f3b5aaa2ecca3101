"""How well pixels are measured: from noise to the uncertainty of a coordinate.

Phase noise is `u_φ = √2/√(M N) · u_I/B` for N steps of M frames each, and the coordinate's `u_φ W/(2π
stripes)`. The noise u_I itself is found by `fpplab.phase.error_model`.
"""

import numpy as np

from fpplab.core.conventions import TWO_PI, Floats


def phase_uncertainty(
    noise: float | Floats, modulation: float | Floats, steps: int, repeats: int = 1
) -> Floats:
    """Compute the standard uncertainty of the phase, `u_φ = √2/√(M N) · u_I/B`."""
    return np.asarray(np.sqrt(2.0 / (repeats * steps)) * np.asarray(noise) / np.asarray(modulation))


def coordinate_uncertainty(phase_sigma: float | Floats, stripes: float, length: int) -> Floats:
    """Compute the standard uncertainty of a projector coordinate, `u_φ W/(2π stripes)`."""
    return np.asarray(np.asarray(phase_sigma) * length / (TWO_PI * stripes))
