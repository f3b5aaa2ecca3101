"""What the compiled decoder has to give: phase, coordinates and orders in plain NumPy."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from fpplab.core.conventions import Axis, Floats, Map, axis_length
from fpplab.patterns.recording import Recording
from fpplab.phase.alternatives import Alternatives, alternatives_of
from fpplab.phase.bounds import PositionInterval, PossibleCoordinates, interval_of, widest_interval_share
from fpplab.phase.demodulation import AxisPhases, axis_phases
from fpplab.phase.error_model import error_model_of
from fpplab.phase.limits import ORDERS
from fpplab.phase.reference import _distances, _penalty_outside_interval, fuse, unwrap
from fpplab.phase.unwrapping import wavelength_sequence


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
    settled = unwrapped.position if plan.order_vote else likeliest.position
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
