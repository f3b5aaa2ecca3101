"""Unwrapping and fusion in plain NumPy, where pixels are few or time is no matter.

The compiled decoder (`fpplab.phase.kernels`) does the same arithmetic in one pass over the pixels; a property
test holds it to this one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import TWO_PI, Floats
from fpplab.phase.bounds import PositionInterval
from fpplab.phase.demodulation import AxisPhases
from fpplab.phase.limits import ORDERS
from fpplab.phase.unwrapping import WavelengthSequence


@dataclass(frozen=True, eq=False)
class Unwrapped:
    """Unwrapped phases of one axis, all shaped like one phase map."""

    position: Floats  # (u + 0.5)/W, the share of the projector's length, 0 … 1
    disagreement: Floats  # greatest |coarse prediction − fine phase| of any wavelength, in its periods
    second_best_order: NDArray[np.int64]  # index of the wavelength that disagreed most
    is_possible: NDArray[np.bool_]  # the position lies in the interval of possible ones, but for noise
    is_unique: NDArray[np.bool_]  # its runner_up, the other hypothesis of the base, differs from it

    @property
    def is_unambiguous(self) -> NDArray[np.bool_]:
        """Whether the position is possible and differs from its runner_up."""
        return self.is_possible & self.is_unique


def unwrap(
    phases: Floats,
    sequence: WavelengthSequence,
    sigma: float | Floats = 0.0,
    edge_margin: float = 0.0,
    changed_order: NDArray[np.int64] | None = None,
    interval: PositionInterval = (0.0, 1.0),
) -> Unwrapped:
    # phases (K, ...)
    turns, wavelengths = phases / TWO_PI, sequence.wavelengths
    measured = [np.tensordot(np.array(w.coefficients, np.float64), turns, axes=1) % 1.0 for w in wavelengths]
    period = 1.0 / wavelengths[0].stripes
    low, high = (np.asarray(end, np.float64) for end in interval)
    middle = 0.5 * (low + high)
    near = (measured[0] + np.floor(middle / period - measured[0] + 0.5)) * period
    other = near + np.where(near > middle, -period, period)
    chosen, cost_near = _refine(near, measured, sequence, changed_order)
    runner_up, cost_other = _refine(other, measured, sequence, changed_order)
    tolerance = edge_margin + ORDERS.edge_sigmas * np.asarray(sigma)
    noise = (wavelengths[-1].stripes * np.asarray(sigma)) ** 2
    apart = np.maximum(ORDERS.min_cost_difference, ORDERS.min_chi2_difference * noise)
    far_near, far_other = (
        _penalty_outside_interval(p.position, low, high, tolerance) for p in (chosen, runner_up)
    )
    swap = cost_other + far_other < cost_near + far_near
    ambiguous = (np.abs(cost_near - cost_other) <= apart) & (far_near == 0) & (far_other == 0)
    inside = np.where(swap, far_other, far_near) == 0
    return Unwrapped(
        np.where(swap, runner_up.position, chosen.position),
        np.where(swap, runner_up.disagreement, chosen.disagreement),
        np.where(swap, runner_up.second_best_order, chosen.second_best_order),
        inside,
        ~ambiguous,
    )


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    position: Floats
    disagreement: Floats
    second_best_order: NDArray[np.int64]


def _refine(
    position: Floats,
    measured: list[Floats],
    sequence: WavelengthSequence,
    changed_order: NDArray[np.int64] | None,
) -> tuple[_Hypothesis, Floats]:
    """A position of the base taken to ever finer wavelengths, and its cost."""
    cost, worst = np.zeros_like(position), np.zeros_like(position)
    second_best = np.zeros(position.shape, np.int64)
    for k, wavelength in enumerate(sequence.wavelengths[1:], start=1):
        expected = position * wavelength.stripes - measured[k]
        order = np.floor(expected + 0.5)
        if changed_order is not None:
            order = order + np.where(np.abs(changed_order) == k, np.sign(changed_order), 0)
        off = expected - order
        cost += sequence.trust[k] * off**2
        second_best = np.where(np.abs(off) > worst, np.where(off > 0, k, -k), second_best)
        worst = np.maximum(worst, np.abs(off))
        position = (order + measured[k]) / wavelength.stripes
    return _Hypothesis(position, worst, second_best), cost


def _penalty_outside_interval(
    position: Floats, low: float | Floats, high: float | Floats, tolerance: Floats
) -> Floats:
    """A penalty above every cost for positions outside of the possible ones; 0 inside."""
    outside = np.maximum(np.maximum(low - position, position - high), 0.0)
    return np.where(outside > tolerance, 100.0 + outside, 0.0)


@dataclass(frozen=True, eq=False)
class Fused:
    """The position from all sets of one axis; see `fpplab.phase.fusion`."""

    position: Floats  # share of the projector's length
    sigma: Floats  # its 1-sigma by noise, and by errors that all pixels of one phase share
    phase_error: Floats  # its 1-sigma by noise, and by errors that all pixels of one phase share
    chi2: Floats  # weighted squares of all K sets about their mean: of K - 1 degrees of freedom


def fuse(measured: AxisPhases, position: Floats) -> Fused:
    """Give the inverse-variance mean of the positions of all sets that agree with the finest."""
    off, variance = _distances(measured, position), measured.position_sigma**2
    weight = 1.0 / variance
    agrees = off**2 <= ORDERS.agreeing_sigmas**2 * (variance + variance[-1])
    agrees[-1] = True
    used = weight * agrees
    total = np.sum(used, axis=0)
    mean = np.sum(weight * off, axis=0) / np.sum(weight, axis=0)
    return Fused(
        position + np.sum(weight * agrees * off, axis=0) / total,
        np.sqrt(np.sum(used**2 * measured.noise, axis=0)) / total,
        np.sqrt(np.sum(used**2 * measured.common, axis=0)) / total,
        np.sum(weight * (off - mean) ** 2, axis=0),
    )


def _distances(measured: AxisPhases, position: Floats) -> Floats:
    """How far each set's nearest position lies from that of the finest, (K, ...)."""
    stripes = measured.stripes.reshape(-1, *[1] * position.ndim)
    off = measured.phases / TWO_PI - position * stripes
    off = (off - np.floor(off + 0.5)) / stripes
    off[-1] = 0.0
    return np.asarray(off)
