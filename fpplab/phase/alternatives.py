"""The wrong fringe orders that a plan risks: shifts of the coordinate that its sets hardly distinguish.

A wrong order moves the position by a whole number m of the finest periods, `Δ = m/s_finest`, and with it the
phase of every other set by what `s_k Δ` lacks to an integer. With the phases' inverse variances the squared
distance of the shifted phases from what is measured, at the best position, is the least χ² that tells the two
apart. Shifts that are sums of likelier ones of the same direction are never the likeliest and are left out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import TWO_PI, Floats
from fpplab.patterns.plan import Plan
from fpplab.phase.limits import ORDERS
from fpplab.phase.unwrapping import WavelengthSequence


@dataclass(frozen=True, eq=False)
class Alternatives:
    """Shifts of the position along one axis, J of them, nearest first; each counts in both directions."""

    shifts: Floats  # share of the projector's length, positive
    turns: Floats  # what every set's phase changes by
    separations: Floats  # (J,)
    causes: NDArray[np.int64]  # index into `Plan.fringes` of the set that tells most of the difference
    least_separation: float

    @property
    def edge(self) -> float:
        """Least shift that is separated less than that: it concerns pixels near the edges alone."""
        worse = self.shifts[self.separations < 0.99 * self.least_separation]
        return float(worse.min()) if len(worse) else np.inf


def alternatives_of(plan: Plan, sequence: WavelengthSequence) -> Alternatives:
    """Find the shifts that a wrong order may cause along one axis."""
    fringes = [plan.fringes[k] for k in sequence.sets]
    stripes = np.array([f.stripes for f in fringes])
    weights = (TWO_PI * stripes / [f.phase_noise for f in fringes]) ** 2
    multiples = np.arange(1, int(np.floor(sequence.width * stripes[-1] + 0.5)) + 1)
    turns = multiples[:, None] / stripes[-1] * stripes
    turns -= np.floor(turns + 0.5)
    whitened = turns / stripes * np.sqrt(weights)
    along = np.sqrt(weights / weights.sum())
    whitened -= (whitened @ along)[:, None] * along
    separations = np.sum(whitened**2, axis=1)
    near = separations[multiples <= 0.5 * sequence.width * stripes[-1]]
    smallest = float(near.min(initial=np.inf))
    kept = _are_irreducible(turns, whitened) & (separations <= ORDERS.max_separation_ratio * smallest)
    causes = (
        np.array(sequence.sets)[np.argmax(whitened**2, axis=1)] if len(multiples) else np.empty(0, np.int64)
    )
    return Alternatives(multiples[kept] / stripes[-1], turns[kept], separations[kept], causes[kept], smallest)


def _are_irreducible(turns: Floats, whitened: Floats) -> NDArray[np.bool_]:
    """Return which shifts are no sum of two smaller ones at an angle of at most 90°."""
    kept = np.ones(len(turns), np.bool_)
    for m in range(1, len(turns)):
        first, second = np.arange(m), np.arange(m)[::-1]
        adds_up = np.all(np.abs(turns[first] + turns[second] - turns[m]) < 1e-6, axis=1)
        kept[m] = not np.any(adds_up & (np.sum(whitened[first] * whitened[second], axis=1) >= 0.0))
    return kept
