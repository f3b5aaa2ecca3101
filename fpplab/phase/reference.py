"""The reference decoder: phase and coordinates in plain NumPy, for any number of pixels.

The compiled decoder (`fpplab.phase.kernels`) does the same arithmetic in one pass over the pixels; a property
test holds it to this one. Reports, data sets and the repair of orders use it where pixels are few or time is
no matter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from fpplab.core.conventions import TWO_PI, Axis, Floats, Map, axis_length
from fpplab.core.errors import DataError
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.recording import Recording
from fpplab.phase.alternatives import Alternatives, alternatives_of
from fpplab.phase.bounds import PositionInterval, PossibleCoordinates, interval_of, widest
from fpplab.phase.error_model import ErrorModel, error_model_of
from fpplab.phase.fusion import AGREEING_SIGMAS, ROUNDING_TURNS
from fpplab.phase.kernels import APART, APART_LEAST
from fpplab.phase.saturation import LEAST_SAMPLES, MOST_LOSS
from fpplab.phase.unwrapping import (
    EDGE_MARGIN_PX,
    EDGE_SIGMAS,
    WavelengthSequence,
    wavelength_sequence,
)
from fpplab.phase.wrong_order import LEAST_INSIDE, LIKELIEST, MOVES


@dataclass(frozen=True, eq=False)
class Wrapped:
    """One demodulated fringe set: maps [v, u], in the grey levels of its frames.

    Attributes
    ----------
    phase : ndarray of float32, (height, width)
        Of `2π stripes (u + 0.5)/W`, in [0, 2π) rad.
    modulation : ndarray of float32, (height, width)
        B.
    offset : ndarray of float32, (height, width)
        The mean.
    misfit : ndarray of float32, (height, width)
        RMS of what the fringe leaves.
    peak : ndarray of float32, (height, width)
        The greatest value in any frame that was used.
    loss : ndarray of float32, (height, width)
        Variance of the phase relative to that from all samples; above 1 where saturated ones were left out.
    """

    phase: Map
    modulation: Map
    offset: Map
    misfit: Map
    peak: Map
    loss: Map


def wrapped_phase(
    frames: Sequence[NDArray[np.generic]], fringe: FringeSet, saturation: float = np.inf
) -> Wrapped:
    """Demodulate one fringe set: `φ = atan2(Σ I_n sin δ_n, Σ I_n cos δ_n)` less the phase origin.

    Parameters
    ----------
    frames : sequence of ndarray, (height, width) each
        The set's images in order, of any real type.
    fringe : FringeSet
        The set.
    saturation : float
        Value from which on a sample is saturated and left out, as long as those that remain give a phase.

    Returns
    -------
    Wrapped
        Phase, modulation, offset, misfit, peak and loss.

    Raises
    ------
    DataError
        Their number is not that of the set's images.
    """
    if len(frames) != fringe.images:
        raise DataError(
            f"a fringe set of {fringe.images} images was given {len(frames)} frames; give all, in order"
        )
    weights = fringe.demodulation()
    shape = np.shape(frames[0])
    s, c, mean, square = (np.zeros(shape) for _ in range(4))
    peak = np.full(shape, -np.inf)
    for n, frame in enumerate(frames):
        level = np.asarray(frame, np.float64)
        s += weights.sine[n] * level
        c += weights.cosine[n] * level
        mean += weights.mean[n] * level
        square += weights.mean[n] * level**2
        np.maximum(peak, level, out=peak)
    loss = np.ones(shape)
    s, c = weights.scale * s, weights.scale * c
    if (peak >= saturation).any():
        levels = np.array([np.asarray(frame, np.float64) for frame in frames])
        _fit_unsaturated(levels, fringe.phase_shifts(), saturation, c, s, mean, square, peak, loss)
    modulation = np.hypot(s, c)
    misfit = np.sqrt(np.maximum(square - mean**2 - modulation**2 / 2.0, 0.0))
    phase = ((np.arctan2(s, c) - weights.origin_rad) % TWO_PI).astype(np.float32)
    # Rounding to float32 must not reach the end of the half-open interval.
    phase[phase >= np.float32(TWO_PI)] = 0.0
    return Wrapped(phase, *(m.astype(np.float32) for m in (modulation, mean, misfit, peak, loss)))


def _fit_unsaturated(
    levels: Floats,
    shift: Floats,
    saturation: float,
    c: Floats,
    s: Floats,
    mean: Floats,
    square: Floats,
    peak: Floats,
    loss: Floats,
) -> None:
    """Replace the results of pixels with saturated samples by least squares of the others, in place."""
    basis = np.stack([np.ones_like(shift), np.cos(shift), np.sin(shift)], axis=1)
    for at in np.argwhere(peak >= saturation):
        pixel, values = tuple(at), levels[(slice(None), *at)]
        used = values < saturation
        own = basis[used]
        if len(own) < LEAST_SAMPLES or np.linalg.matrix_rank(own) < 3:
            continue
        fitted = np.linalg.lstsq(own, values[used], rcond=None)[0]
        along = np.array([0.0, -fitted[2], fitted[1]]) / max(np.hypot(fitted[1], fitted[2]), 1e-30)
        variance = len(shift) / 2.0 * along @ np.linalg.inv(own.T @ own) @ along
        if variance > MOST_LOSS:
            continue
        mean[pixel], c[pixel], s[pixel] = fitted
        rest = np.mean((values[used] - own @ fitted) ** 2)
        square[pixel] = rest + fitted[0] ** 2 + (fitted[1] ** 2 + fitted[2] ** 2) / 2.0
        peak[pixel], loss[pixel] = values[used].max(), variance


@dataclass(frozen=True, eq=False)
class Unwrapped:
    """Unwrapped phases of one axis, all shaped like one phase map.

    Attributes
    ----------
    position : ndarray of float64
        (u + 0.5)/W, the share of the projector's length, 0 … 1.
    disagreement : ndarray of float64
        Greatest |coarse prediction − fine phase| of any wavelength, in its periods.
    second_best_order : ndarray of int64
        Index of the wavelength that disagreed most, signed towards its second-best order; 0 if none did.
    is_possible : ndarray of bool
        The position lies in the interval of possible ones, but for noise.
    is_told_apart : ndarray of bool
        Its rival, the other hypothesis of the base, is told apart from it.
    """

    position: Floats
    disagreement: Floats
    second_best_order: NDArray[np.int64]
    is_possible: NDArray[np.bool_]
    is_told_apart: NDArray[np.bool_]

    @property
    def is_unambiguous(self) -> NDArray[np.bool_]:
        """Whether the position is possible and told apart from its rival."""
        return self.is_possible & self.is_told_apart


def unwrap(
    phases: Floats,
    sequence: WavelengthSequence,
    sigma: float | Floats = 0.0,
    edge_margin: float = 0.0,
    changed_order: NDArray[np.int64] | None = None,
    interval: PositionInterval = (0.0, 1.0),
) -> Unwrapped:
    """Unwrap the wrapped phases of one axis.

    Parameters
    ----------
    phases : ndarray of float64, (K, ...)
        rad, of the sequence's sets, fewest stripes first.
    sequence : WavelengthSequence
        The axis' synthetic wavelengths.
    sigma : float or ndarray of float64, (...)
        1-sigma of the position, as a share of the projector's length.
    edge_margin : float
        How far beyond the projector's edge a position may lie without noise, the same.
    changed_order : ndarray of int64, (...), optional
        A wavelength's index, up to its sign: the order chosen on that wavelength is changed by that sign; 0
        changes nothing.
    interval : tuple of float or ndarray of float64, (...)
        Least and greatest possible position, as shares of the projector's length.

    Returns
    -------
    Unwrapped
        Positions, and how far they can be trusted.
    """
    turns, wavelengths = phases / TWO_PI, sequence.wavelengths
    measured = [np.tensordot(np.array(w.coefficients, np.float64), turns, axes=1) % 1.0 for w in wavelengths]
    period = 1.0 / wavelengths[0].stripes
    low, high = (np.asarray(end, np.float64) for end in interval)
    middle = 0.5 * (low + high)
    near = (measured[0] + np.floor(middle / period - measured[0] + 0.5)) * period
    other = near + np.where(near > middle, -period, period)
    chosen, cost_near = _refine(near, measured, sequence, changed_order)
    rival, cost_other = _refine(other, measured, sequence, changed_order)
    tolerance = edge_margin + EDGE_SIGMAS * np.asarray(sigma)
    apart = np.maximum(APART_LEAST, APART * (wavelengths[-1].stripes * np.asarray(sigma)) ** 2)
    far_near, far_other = (_beyond(p.position, low, high, tolerance) for p in (chosen, rival))
    swap = cost_other + far_other < cost_near + far_near
    alike = (np.abs(cost_near - cost_other) <= apart) & (far_near == 0) & (far_other == 0)
    inside = np.where(swap, far_other, far_near) == 0
    return Unwrapped(
        np.where(swap, rival.position, chosen.position),
        np.where(swap, rival.disagreement, chosen.disagreement),
        np.where(swap, rival.second_best_order, chosen.second_best_order),
        inside,
        ~alike,
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


def _beyond(position: Floats, low: float | Floats, high: float | Floats, tolerance: Floats) -> Floats:
    """A penalty above every cost for positions outside of the possible ones; 0 inside."""
    outside = np.maximum(np.maximum(low - position, position - high), 0.0)
    return np.where(outside > tolerance, 100.0 + outside, 0.0)


@dataclass(frozen=True, eq=False)
class AxisPhases:
    """What pixels of any shape (...) see of the K sets of one axis, fewest stripes first.

    Attributes
    ----------
    phases : ndarray of float64, (K, ...)
        Wrapped phases in rad.
    noise, common : ndarray of float64, (K, ...)
        Variance of the position that each set gives, as a squared share of the projector's length: by noise,
        and by errors that all pixels of one phase share.
    stripes : ndarray of float64, (K,)
        Of each set.
    """

    phases: Floats
    noise: Floats
    common: Floats
    stripes: Floats

    @property
    def position_sigma(self) -> Floats:
        """1-sigma of the position that each set gives, by both, (K, ...)."""
        return np.asarray(np.sqrt(self.noise + self.common))


def axis_phases(recording: Recording, sequence: WavelengthSequence, errors: ErrorModel) -> AxisPhases:
    """Demodulate all sets of one axis.

    Parameters
    ----------
    recording : Recording
        Frames of any shape (...).
    sequence : WavelengthSequence
        Of the axis.
    errors : ErrorModel
        Of the recording.

    Returns
    -------
    AxisPhases
        Of the frames' shape.
    """
    fringes = [recording.plan.fringes[k] for k in sequence.sets]
    sets = [
        wrapped_phase(recording.of_set(k), f, errors.saturation)
        for k, f in zip(sequence.sets, fringes, strict=True)
    ]
    noises, commons = [], []
    for k, one, fringe in zip(sequence.sets, sets, fringes, strict=True):
        level = one.offset.astype(np.float64) * recording.grey
        modulation = np.maximum(one.modulation.astype(np.float64) * recording.grey, 1e-30)
        per_level = fringe.phase_noise**2 * one.loss / modulation**2
        repeated = errors.noise.repeated(level)
        own = per_level * (errors.noise.variance(level) - repeated) / TWO_PI**2 + ROUNDING_TURNS**2
        common = per_level * repeated + errors.sets[k].variance(level / modulation)
        noises.append(own / fringe.stripes**2)
        # Where nothing tells the common errors, noise alone counts.
        commons.append(np.nan_to_num(common) / (TWO_PI * fringe.stripes) ** 2)
    return AxisPhases(
        np.array([one.phase for one in sets], np.float64),
        np.array(noises),
        np.array(commons),
        np.array([f.stripes for f in fringes]),
    )


@dataclass(frozen=True, eq=False)
class Fused:
    """The position from all sets of one axis; see `fpplab.phase.fusion`.

    Attributes
    ----------
    position : ndarray of float64, (...)
        Share of the projector's length.
    sigma, phase_error : ndarray of float64, (...)
        Its 1-sigma by noise, and by errors that all pixels of one phase share.
    chi2 : ndarray of float64, (...)
        Weighted squares of all K sets about their mean: of K - 1 degrees of freedom.
    """

    position: Floats
    sigma: Floats
    phase_error: Floats
    chi2: Floats


def fuse(seen: AxisPhases, position: Floats) -> Fused:
    """Give the inverse-variance mean of the positions of all sets that agree with the finest.

    Parameters
    ----------
    seen : AxisPhases
        Phases and their uncertainties.
    position : ndarray of float64, (...)
        Of the finest set, as a share of the projector's length.

    Returns
    -------
    Fused
        Position, sigma and χ².
    """
    off, variance = _distances(seen, position), seen.position_sigma**2
    weight = 1.0 / variance
    agrees = off**2 <= AGREEING_SIGMAS**2 * (variance + variance[-1])
    agrees[-1] = True
    used = weight * agrees
    total = np.sum(used, axis=0)
    mean = np.sum(weight * off, axis=0) / np.sum(weight, axis=0)
    return Fused(
        position + np.sum(weight * agrees * off, axis=0) / total,
        np.sqrt(np.sum(used**2 * seen.noise, axis=0)) / total,
        np.sqrt(np.sum(used**2 * seen.common, axis=0)) / total,
        np.sum(weight * (off - mean) ** 2, axis=0),
    )


def _distances(seen: AxisPhases, position: Floats) -> Floats:
    """How far each set's nearest position lies from that of the finest, (K, ...)."""
    stripes = seen.stripes.reshape(-1, *[1] * position.ndim)
    off = seen.phases / TWO_PI - position * stripes
    off = (off - np.floor(off + 0.5)) / stripes
    off[-1] = 0.0
    return np.asarray(off)


def _evidence(seen: AxisPhases, position: Floats, ends: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """χ² of a position's orders, and the share of its mean's distribution that lies between the ends."""
    off, weight = _distances(seen, position), seen.position_sigma**-2
    total = weight.sum(axis=0)
    moment = np.sum(weight * off, axis=0)
    mean, per_sigma = position + moment / total, np.sqrt(0.5 * total)
    share = 0.5 * (erfc((ends[0] - mean) * per_sigma) - erfc((ends[1] - mean) * per_sigma))
    return np.sum(weight * off**2, axis=0) - moment**2 / total, share


@dataclass(frozen=True, eq=False)
class LikeliestOrder:
    """The likeliest position of each pixel, see `fpplab.phase.wrong_order`.

    Attributes
    ----------
    position : ndarray of float64, (...)
        Of the finest set, as a share of the projector's length.
    is_changed : ndarray of bool, (...)
        It is another than the one that was found step by step.
    wrong : ndarray of float64, (...)
        Probability that its order is wrong, 0 … 1.
    """

    position: Floats
    is_changed: NDArray[np.bool_]
    wrong: Floats


def likeliest_order(
    seen: AxisPhases,
    found: Floats,
    alternatives: Alternatives,
    interval: PositionInterval,
    edge_margin: float,
) -> LikeliestOrder:
    """Move every pixel to its likeliest position, and compute the probability that this is wrong.

    Parameters
    ----------
    seen : AxisPhases
        Phases and their uncertainties.
    found : ndarray of float64, (...)
        Position of the finest set, as a share of the projector's length.
    alternatives : Alternatives
        Of the plan along this axis.
    interval : tuple of float or ndarray of float64, (...)
        Least and greatest possible position.
    edge_margin : float
        How far beyond them a position may lie without noise.

    Returns
    -------
    LikeliestOrder
        Of the shape of `found`.
    """
    ends = np.asarray(interval[0]) - edge_margin, np.asarray(interval[1]) + edge_margin
    position = found
    for _ in range(MOVES):
        step, _ = _likeliest_shift(seen, position, alternatives, ends)
        if not step.any():
            break
        position = position + step
    _, odds = _likeliest_shift(seen, position, alternatives, ends)
    return LikeliestOrder(position, position != found, odds / (1.0 + odds))


def _likeliest_shift(
    seen: AxisPhases, position: Floats, alternatives: Alternatives, ends: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Shift to the likeliest alternative, 0 where none is likelier; and the odds of all together."""
    best, inside = _evidence(seen, position, ends)
    odds, likeliest, step = np.zeros_like(position), np.ones_like(position), np.zeros_like(position)
    for shift in (*alternatives.shifts, *-alternatives.shifts):
        chi2, share = _evidence(seen, position + shift, ends)
        own = np.exp(np.minimum(0.5 * (best - chi2), LIKELIEST)) * share / np.maximum(inside, LEAST_INSIDE)
        step = np.where(own > likeliest, shift, step)
        likeliest = np.maximum(own, likeliest)
        odds += own
    return step, odds


@dataclass(frozen=True, eq=False)
class DecodedAxis:
    """One axis as the reference decodes it: maps [v, u], NaN where the order stays ambiguous.

    Attributes
    ----------
    coordinate, sigma : ndarray of float32, (height, width)
        Projector coordinate and its 1-sigma in px.
    disagreement : ndarray of float32, (height, width)
        Root of χ² per degree of freedom; 0 for a single set.
    wrong_order : ndarray of float32, (height, width)
        Probability that the fringe order is wrong; known where the order is ambiguous too.
    """

    coordinate: Map
    sigma: Map
    disagreement: Map
    wrong_order: Map


def decode_axis(
    recording: Recording, axis: Axis, bounds: Mapping[Axis, PossibleCoordinates] | None = None
) -> DecodedAxis:
    """Decode one axis, without masks and without repair of orders.

    The compiled decoder (`fpplab.phase.decoding.decode`) must give the same wherever it gives anything.

    Parameters
    ----------
    recording : Recording
        Frames of a plan that codes the axis.
    axis : str
        Which axis, x or y.
    bounds : mapping of str to PossibleCoordinates, optional
        As for `fpplab.phase.decoding.decode`.

    Returns
    -------
    DecodedAxis
        Maps of float32.

    Raises
    ------
    ConfigError
        The plan cannot be unwrapped.
    """
    plan, length = recording.plan, axis_length(recording.projector_size, axis)
    width, margin = widest(bounds, axis, recording.projector_size), EDGE_MARGIN_PX / length
    sequence = wavelength_sequence(plan, axis, recording.name, width)
    seen, interval = (
        axis_phases(recording, sequence, error_model_of(recording)),
        interval_of(bounds, axis, length),
    )
    found = unwrap(seen.phases, sequence, seen.position_sigma[-1], margin, interval=interval)
    risks = alternatives_of(plan, sequence)
    likeliest = likeliest_order(seen, found.position, risks, interval, margin)
    settled = found.position if plan.order_vote else likeliest.position
    fused, freedom = fuse(seen, settled), max(len(sequence.sets) - 1, 1)
    is_explained = fused.chi2 <= AGREEING_SIGMAS**2 * freedom
    tolerance = margin + EDGE_SIGMAS * seen.position_sigma[-1]
    is_possible = _beyond(settled, *interval, tolerance) == 0
    is_known = found.is_told_apart & is_possible & (is_explained | (settled == found.position))
    known = np.where(is_known, 1.0, np.nan)
    return DecodedAxis(
        coordinate=((fused.position * length - 0.5) * known).astype(np.float32),
        sigma=(fused.sigma * length * known).astype(np.float32),
        disagreement=(np.sqrt(fused.chi2 / freedom) * known).astype(np.float32),
        wrong_order=likeliest.wrong.astype(np.float32),
    )
