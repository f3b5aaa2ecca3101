"""How precise noise leaves phases and coordinates, and which pixels it costs.

Phase noise is `u_φ = √2/√(M N) · u_I/B` for N steps of M frames each, and the coordinate's `u_φ W/(2π
stripes)`. The noise u_I itself is found by `fpplab.phase.error_model`.
"""

from collections.abc import Sequence

import numpy as np

from fpplab.core.conventions import TWO_PI, Axis, Floats, axis_length
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.plan import Plan
from fpplab.phase.decoded import Decoded


def phase_uncertainty(
    noise: float | Floats, modulation: float | Floats, steps: int, repeats: int = 1
) -> Floats:
    """Compute the standard uncertainty of the phase, `u_φ = √2/√(M N) · u_I/B`."""
    return np.asarray(np.sqrt(2.0 / (repeats * steps)) * np.asarray(noise) / np.asarray(modulation))


def coordinate_uncertainty(phase_sigma: float | Floats, stripes: float, length: int) -> Floats:
    """Compute the standard uncertainty of a projector coordinate, `u_φ W/(2π stripes)`."""
    return np.asarray(np.asarray(phase_sigma) * length / (TWO_PI * stripes))


def coordinate_spread(
    plan: Plan, axis: Axis, projector_size: tuple[int, int], sets: Sequence[int] | None = None
) -> float:
    """Compute the standard uncertainty of a coordinate where noise and modulation are equal in all sets."""
    # It is the Cramér-Rao bound of their images: `1/√Σ σ_k⁻²` with the uncertainty σ_k of each set alone.
    # projector_size (width, height) px
    length = axis_length(projector_size, axis)
    fringes = [plan.fringes[k] for k in (plan.sets_along(axis) if sets is None else sets)]
    alone = [coordinate_uncertainty(f.phase_noise, f.stripes, length) for f in fringes]
    return float(1.0 / np.sqrt(np.sum(np.square(np.reciprocal(alone)))))


def uncertain_orders(decoded: Decoded, plan: Plan) -> dict[str, int] | None:
    """Count the pixels that their fringe order, too uncertain, leaves out, by the set at fault."""
    if decoded.uncertain_order is None:
        return None
    sets = (plan.fringe_part or plan).sets
    causes: dict[str, int] = {}
    for number, each in enumerate(sets, 1):
        if count := np.count_nonzero(decoded.uncertain_order == number):
            unit = " stripes" if isinstance(each, FringeSet) else ""
            axis = f"{each.coded_axis} " if each.coded_axis else ""
            name = f"{axis}{each.short_name}{unit}"
            causes[name] = causes.get(name, 0) + count
    return causes
