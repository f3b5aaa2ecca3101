"""What the compiled decoder has to give: phase, coordinates and orders in plain NumPy."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from fpplab.core.conventions import TWO_PI, Axis, Floats, Map, axis_length
from fpplab.patterns.recording import Recording
from fpplab.phase.alternatives import Alternatives, alternatives_of
from fpplab.phase.bounds import PositionInterval, PossibleCoordinates, interval_of, widest_interval_share
from fpplab.phase.demodulation import AxisPhases, axis_phases
from fpplab.phase.error_model import error_model_of
from fpplab.phase.limits import ORDERS
from fpplab.phase.unwrapping import WavelengthSequence, wavelength_sequence


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
    chosen, cost_near = _refine(near, measured, sequence)
    runner_up, cost_other = _refine(other, measured, sequence)
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
) -> tuple[_Hypothesis, Floats]:
    """A position of the base taken to ever finer wavelengths, and its cost."""
    cost, worst = np.zeros_like(position), np.zeros_like(position)
    second_best = np.zeros(position.shape, np.int64)
    for k, wavelength in enumerate(sequence.wavelengths[1:], start=1):
        expected = position * wavelength.stripes - measured[k]
        order = np.floor(expected + 0.5)
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


def _chi2_and_share_inside(
    measured: AxisPhases, position: Floats, ends: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """χ² of a position's orders, and the share of its mean's distribution that lies between the ends."""
    off = _distances(measured, position)
    weight = 1.0 / (measured.noise + measured.counted_share * measured.common)
    total = weight.sum(axis=0)
    moment = np.sum(weight * off, axis=0)
    mean, per_sigma = position + moment / total, np.sqrt(0.5 * total)
    share = 0.5 * (erfc((ends[0] - mean) * per_sigma) - erfc((ends[1] - mean) * per_sigma))
    return np.sum(weight * off**2, axis=0) - moment**2 / total, share


@dataclass(frozen=True, eq=False)
class LikeliestOrder:
    """The likeliest position of each pixel, see `fpplab.phase.wrong_order`."""

    position: Floats  # of the finest set, as a share of the projector's length
    is_changed: NDArray[np.bool_]  # it is another than the one that was found step by step
    wrong: Floats  # probability that its order is wrong, 0 … 1


def likeliest_order(
    measured: AxisPhases,
    start: Floats,
    alternatives: Alternatives,
    interval: PositionInterval,
    edge_margin: float,
) -> LikeliestOrder:
    """Move every pixel to its likeliest position, and compute the probability that this is wrong."""
    ends = np.asarray(interval[0]) - edge_margin, np.asarray(interval[1]) + edge_margin
    position = start
    for _ in range(ORDERS.max_moves):
        step, _ = _likeliest_shift(measured, position, alternatives, ends)
        if not step.any():
            break
        position = position + step
    _, odds = _likeliest_shift(measured, position, alternatives, ends)
    return LikeliestOrder(position, position != start, odds / (1.0 + odds))


def _likeliest_shift(
    measured: AxisPhases, position: Floats, alternatives: Alternatives, ends: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Shift to the likeliest alternative, 0 where none is likelier; and the odds of all together."""
    best, inside = _chi2_and_share_inside(measured, position, ends)
    odds, likeliest, step = np.zeros_like(position), np.ones_like(position), np.zeros_like(position)
    for shift in (*alternatives.shifts, *-alternatives.shifts):
        chi2, share = _chi2_and_share_inside(measured, position + shift, ends)
        odds_of_shift = np.exp(np.minimum(0.5 * (best - chi2), ORDERS.cap_log_odds))
        own = odds_of_shift * share / np.maximum(inside, ORDERS.min_share_inside)
        step = np.where(own > likeliest, shift, step)
        likeliest = np.maximum(own, likeliest)
        odds += own
    return step, odds


@dataclass(frozen=True, eq=False)
class DecodedAxis:
    """One axis as the reference decodes it: maps [v, u], NaN where the order stays ambiguous."""

    coordinate: Map  # projector coordinate and its 1-sigma in px
    sigma: Map  # projector coordinate and its 1-sigma in px
    disagreement: Map  # root of χ² per degree of freedom; 0 for a single set
    wrong_order: Map  # probability that the fringe order is wrong; known where the order is ambiguous too


def decode_axis(
    recording: Recording, axis: Axis, bounds: Mapping[Axis, PossibleCoordinates] | None = None
) -> DecodedAxis:
    """Decode one axis, without masks and without repair of orders.

    The compiled decoder (`fpplab.phase.decoding.decode`) must give the same wherever it gives anything.
    """
    plan, length = recording.plan, axis_length(recording.projector_size, axis)
    width = widest_interval_share(bounds, axis, recording.projector_size)
    margin = ORDERS.edge_margin_px / length
    sequence = wavelength_sequence(plan, axis, recording.name, width)
    measured, interval = (
        axis_phases(recording, sequence, error_model_of(recording)),
        interval_of(bounds, axis, length),
    )
    unwrapped = unwrap(measured.phases, sequence, measured.position_sigma[-1], margin, interval=interval)
    risks = alternatives_of(plan, sequence)
    likeliest = likeliest_order(measured, unwrapped.position, risks, interval, margin)
    settled = likeliest.position
    fused, freedom = fuse(measured, settled), max(len(sequence.sets) - 1, 1)
    is_explained = fused.chi2 <= ORDERS.agreeing_sigmas**2 * freedom
    tolerance = margin + ORDERS.edge_sigmas * measured.position_sigma[-1]
    is_possible = _penalty_outside_interval(settled, *interval, tolerance) == 0
    is_known = unwrapped.is_unique & is_possible & (is_explained | (settled == unwrapped.position))
    mask = np.where(is_known, 1.0, np.nan)
    return DecodedAxis(
        coordinate=((fused.position * length - 0.5) * mask).astype(np.float32),
        sigma=(fused.sigma * length * mask).astype(np.float32),
        disagreement=(np.sqrt(fused.chi2 / freedom) * mask).astype(np.float32),
        wrong_order=likeliest.wrong.astype(np.float32),
    )
