"""Which pixels are measured, and how well: masks, and from noise to the uncertainty of a coordinate.

Phase noise is `u_φ = √2/√(M N) · u_I/B` for N steps of M frames each, and the coordinate's `u_φ W/(2π
stripes)`. The noise u_I itself is found by `fpplab.phase.error_model`.
"""

from __future__ import annotations

import numpy as np

from fpplab.core.conventions import TWO_PI, Floats, Mask
from fpplab.patterns.plan import MaskRules


def phase_uncertainty(
    noise: float | Floats, modulation: float | Floats, steps: int, repeats: int = 1
) -> Floats:
    """Compute the standard uncertainty of the phase, `u_φ = √2/√(M N) · u_I/B`."""
    return np.asarray(np.sqrt(2.0 / (repeats * steps)) * np.asarray(noise) / np.asarray(modulation))


def coordinate_uncertainty(phase_sigma: float | Floats, stripes: float, length: int) -> Floats:
    """Compute the standard uncertainty of a projector coordinate, `u_φ W/(2π stripes)`."""
    return np.asarray(np.asarray(phase_sigma) * length / (TWO_PI * stripes))


def measurable(
    modulation: Floats,
    offset: Floats,
    misfit: Floats,
    peak: Floats,
    rules: MaskRules,
    full_scale: float,
) -> Mask:
    """Find the pixels where one fringe set satisfies the mask rules."""
    return np.asarray(
        (modulation > 0)
        & (modulation >= rules.modulation_min)
        & (modulation >= rules.contrast_min * offset)
        & (misfit <= rules.residual_max * modulation)
        & (peak < full_scale)
    )
