"""Temporal unwrapping: one ladder of rungs for hierarchical and heterodyne plans.

A rung is an integer combination of the measured wrapped phases, and so itself a
wrapped phase, of its own effective stripe count. Hierarchical plans have the sets
themselves for rungs; heterodyne plans add the beats of neighbours, the beats of
those, and so on until one beat has at most one stripe. The position found on one
rung says which period of the next one is meant; the last rung is the finest set.

The base wraps at the projector's edges, where its noise would throw whole fringes.
So two hypotheses climb: the base as measured, and one turn off. The one that ends
inside the projector wins; where both do, the one that agrees better with the rungs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fpplab.core.conventions import TWO_PI, Axis, Floats, Map
from fpplab.core.errors import ConfigError
from fpplab.patterns.plan import Plan
from fpplab.phase.kernels import APART, APART_LEAST, EDGE_SIGMAS

_NEGLIGIBLE = 1e-9


@dataclass(frozen=True)
class SyntheticWavelength:
    """One effective fringe: `coefficients` of the wrapped phases of the ladder's sets, and its stripes."""

    coefficients: tuple[int, ...]
    stripes: float

    def beat(self, coarser: SyntheticWavelength) -> SyntheticWavelength:
        """The difference of two rungs: as many stripes as they differ by."""
        difference = zip(self.coefficients, coarser.coefficients, strict=True)
        return SyntheticWavelength(tuple(a - b for a, b in difference), self.stripes - coarser.stripes)


@dataclass(frozen=True)
class WavelengthSequence:
    """How one axis is unwrapped: `sets` index `Plan.fringes`, `rungs` go from coarse to fine.

    The first rung has at most one stripe; the last is the finest set itself. trust:
    of each rung the inverse variance of its disagreement with the one before, where the
    variance of the finest phase is one; 0 for the base.
    """

    axis: Axis
    sets: tuple[int, ...]
    rungs: tuple[SyntheticWavelength, ...]
    trust: tuple[float, ...]

    @property
    def finest(self) -> int:
        """Index into `Plan.fringes` of the set that gives the coordinate."""
        return self.sets[-1]


@dataclass(frozen=True, eq=False)
class Unwrapped:
    """Where a ladder led: float64, shaped like one phase map.

    position: (u + 0.5)/W, the share of the projector's length, 0 … 1.
    disagreement: greatest |coarse prediction − fine phase| of any rung, in its periods.
    doubted: the rung that disagreed most, signed towards its second-best order; 0 if none did.
    certain: the hypothesis lies in the projector and is told apart from the other one.
    """

    position: Floats
    disagreement: Floats
    doubted: NDArray[np.int64]
    certain: NDArray[np.bool_]


def wavelength_sequence(plan: Plan, axis: Axis, source: str) -> WavelengthSequence:
    """The ladder of one coded axis.

    Raises `ConfigError` when the plan cannot be unwrapped without ambiguity; its
    message says which stripes would do.
    """
    sets = plan.sets_along(axis)
    units = [
        SyntheticWavelength(tuple(int(i == k) for i in range(len(sets))), plan.fringes[index].stripes)
        for k, index in enumerate(sets)
    ]
    rungs = _with_beats(units) if plan.unwrapping == "heterodyne" else units
    coarse = [r for r in rungs if r.stripes <= 1 + _NEGLIGIBLE]
    if not coarse:
        raise ConfigError(_ambiguous(plan, axis, source, rungs[0].stripes))
    kept = (coarse[-1], *(r for r in rungs if r.stripes > 1 + _NEGLIGIBLE))
    return WavelengthSequence(axis, sets, kept, _trust(kept, [plan.fringes[i].steps for i in sets]))


def check_unwrapping(plan: Plan, source: str) -> None:
    """Refuse a plan that cannot be unwrapped, before anything is projected: `ConfigError`."""
    for axis in plan.axes:
        wavelength_sequence(plan, axis, source)


def _trust(rungs: tuple[SyntheticWavelength, ...], steps: list[int]) -> tuple[float, ...]:
    def variance(rung: SyntheticWavelength) -> float:
        return sum(c * c * steps[-1] / n for c, n in zip(rung.coefficients, steps, strict=True))

    predicted = (variance(q) * (r.stripes / q.stripes) ** 2 for q, r in pairwise(rungs))
    return (0.0, *(1.0 / (p + variance(r)) for p, r in zip(predicted, rungs[1:], strict=True)))


def _with_beats(units: list[SyntheticWavelength]) -> list[SyntheticWavelength]:
    """The sets and their beats, fewest stripes first, every stripe count once."""
    rungs, level = list(units), units
    while level and min(r.stripes for r in level) > 1 + _NEGLIGIBLE:
        level = sorted(level, key=lambda r: r.stripes)
        beats = (fine.beat(coarse) for coarse, fine in pairwise(level))
        level = [b for b in beats if b.stripes > _NEGLIGIBLE]
        rungs += level
    # Of equal rungs the one with fewer phases in it carries less noise; sets come last.
    rungs.sort(key=lambda r: (r.stripes, -_noise_gain(r)))
    return [
        r
        for r, following in zip(rungs, [*rungs[1:], None], strict=True)
        if following is None or following.stripes - r.stripes > _NEGLIGIBLE
    ]


def _noise_gain(rung: SyntheticWavelength) -> int:
    """By how much the variance of the rung's phase exceeds that of one set."""
    return sum(c * c for c in rung.coefficients)


def _ambiguous(plan: Plan, axis: Axis, source: str, coarsest: float) -> str:
    stripes = [plan.fringes[i].stripes for i in plan.sets_along(axis)]
    listed = ", ".join(f"{s:g}" for s in stripes)
    if plan.unwrapping == "hierarchical":
        return (
            f"{source}: 'fringes' along {axis} have {listed} stripes: hierarchical unwrapping needs a set "
            f"of at most 1 stripe, and the fewest here is {coarsest:g}; add one, for example stripes 1, "
            f"{math.sqrt(stripes[-1]):.3g}, {stripes[-1]:g}"
        )
    step = max(2, round(math.sqrt(stripes[-1])))
    finest = max(stripes[-1], 2 * step)
    return (
        f"{source}: 'fringes' along {axis} have {listed} stripes: heterodyne unwrapping needs beats of "
        f"neighbours that reach at most 1 stripe, and they stop at {coarsest:g}; for example stripes "
        f"{finest - 2 * step + 1:g}, {finest - step:g}, {finest:g} do"
    )


def unwrap(
    phases: Floats,
    ladder: WavelengthSequence,
    sigma: float | Floats = 0.0,
    seam: float = 0.0,
    nudged: NDArray[np.int64] | None = None,
) -> Unwrapped:
    """Unwrap the wrapped phases of one axis; the compiled decoder's arithmetic in plain NumPy.

    Parameters
    ----------
    phases: (K, ...) rad, of the ladder's sets, fewest stripes first.
    sigma: 1-sigma of the position, as a share of the projector's length.
    seam: how far beyond the projector's edge a position may lie without noise, the same.
    nudged: (...) a rung's index, up to its sign: the order chosen on that rung is
        changed by that sign; 0 changes nothing.
    """
    turns = phases / TWO_PI
    measured = [np.tensordot(np.array(r.coefficients, np.float64), turns, axes=1) % 1.0 for r in ladder.rungs]
    period = 1.0 / ladder.rungs[0].stripes
    near = measured[0] * period
    other = near + np.where(measured[0] > 0.5, -period, period)
    chosen, cost_near = _ascend(near, measured, ladder, nudged)
    rival, cost_other = _ascend(other, measured, ladder, nudged)
    tolerance = seam + EDGE_SIGMAS * np.asarray(sigma)
    apart = np.maximum(APART_LEAST, APART * (ladder.rungs[-1].stripes * np.asarray(sigma)) ** 2)
    far_near, far_other = (_beyond(p.position, tolerance) for p in (chosen, rival))
    swap = cost_other + far_other < cost_near + far_near
    alike = (np.abs(cost_near - cost_other) <= apart) & (far_near == 0) & (far_other == 0)
    inside = np.where(swap, far_other, far_near) == 0
    return Unwrapped(
        np.where(swap, rival.position, chosen.position),
        np.where(swap, rival.disagreement, chosen.disagreement),
        np.where(swap, rival.doubted, chosen.doubted),
        inside & ~alike,
    )


@dataclass(frozen=True, eq=False)
class _Ascent:
    position: Floats
    disagreement: Floats
    doubted: NDArray[np.int64]


def _ascend(
    position: Floats, measured: list[Floats], ladder: WavelengthSequence, nudged: NDArray[np.int64] | None
) -> tuple[_Ascent, Floats]:
    cost, worst = np.zeros_like(position), np.zeros_like(position)
    doubted = np.zeros(position.shape, np.int64)
    for k, rung in enumerate(ladder.rungs[1:], start=1):
        expected = position * rung.stripes - measured[k]
        order = np.floor(expected + 0.5)
        if nudged is not None:
            order = order + np.where(np.abs(nudged) == k, np.sign(nudged), 0)
        off = expected - order
        cost += ladder.trust[k] * off**2
        doubted = np.where(np.abs(off) > worst, np.where(off > 0, k, -k), doubted)
        worst = np.maximum(worst, np.abs(off))
        position = (order + measured[k]) / rung.stripes
    return _Ascent(position, worst, doubted), cost


def _beyond(position: Floats, tolerance: Floats) -> Floats:
    """A penalty above every cost for positions outside the projector; 0 inside."""
    outside = np.maximum(np.maximum(-position, position - 1.0), 0.0)
    return np.where(outside > tolerance, 100.0 + outside, 0.0)


DOUBTFUL = 0.25
"""Share of a period beyond which a disagreement makes an order doubtful: clean data stay below."""

_PASSES = 5


def vote_orders(
    coordinate: Map, pixels: NDArray[np.int64], alternative: Floats, window: int, period: float
) -> NDArray[np.bool_]:
    """Repair fringe orders by local majority, in place.

    Light from the surroundings biases a coarse set, and then some orders are wrong by
    one. A doubtful pixel's neighbours vote for the one of its two coordinates that lies
    within a quarter of their difference of their own; who is near neither abstains. Only
    doubtful pixels ever change, so a step edge in clean data cannot be voted away.

    Parameters
    ----------
    coordinate: (height, width) float32 px, NaN where invalid; repaired in place.
    pixels: (P,) flat indices of the doubtful pixels. alternative: (P,) px, the coordinate
        that each would have with its second-best order, NaN if that lies outside the projector.
    window: side of the square of neighbours, odd. period: px of the finest fringes; a quarter of it is
        near enough where there is no alternative.

    Returns
    -------
    (P,) whether more than half of the measured neighbours stand behind the pixel's coordinate.
    """
    other = alternative.astype(np.float32)
    backed = np.zeros(len(pixels), np.bool_)
    for _ in range(_PASSES):
        if not _vote(coordinate, pixels, other, window // 2, np.float32(period), backed):
            break
    return backed


@njit(nogil=True, cache=True)
def _vote(
    coordinate: Map,
    pixels: NDArray[np.int64],
    other: Map,
    reach: int,
    period: np.float32,
    backed: NDArray[np.bool_],
) -> int:
    """One pass; returns how many pixels changed. `other` keeps what they changed from."""
    height, width = coordinate.shape
    swap = np.zeros(len(pixels), np.bool_)
    for p in range(len(pixels)):
        row, column = pixels[p] // width, pixels[p] % width
        own, rival = coordinate[row, column], other[p]
        near = (abs(own - rival) if np.isfinite(rival) else period) / 4
        for_own, for_rival, measured = 0, 0, 0
        for r in range(max(0, row - reach), min(height, row + reach + 1)):
            for c in range(max(0, column - reach), min(width, column + reach + 1)):
                if r != row or c != column:
                    measured += np.isfinite(coordinate[r, c])
                    for_own += abs(coordinate[r, c] - own) <= near
                    for_rival += abs(coordinate[r, c] - rival) <= near
        swap[p] = for_rival > for_own
        backed[p] = 2 * max(for_own, for_rival) > measured
    for p in range(len(pixels)):
        if swap[p]:
            row, column = pixels[p] // width, pixels[p] % width
            coordinate[row, column], other[p] = other[p], coordinate[row, column]
    return int(swap.sum())
