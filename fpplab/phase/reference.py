"""The reference decoder: phase and coordinates in plain NumPy, for any number of pixels.

The compiled decoder (`fpplab.phase.kernels`) does the same arithmetic in one pass over the pixels; a property
test holds it to this one. Reports, data sets and the repair of orders use it where pixels are few or time is
no matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import TWO_PI, Axis, Floats, Map, axis_length
from fpplab.core.errors import DataError
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.recording import Recording
from fpplab.phase.error_model import error_model_of
from fpplab.phase.kernels import APART, APART_LEAST, EDGE_SIGMAS
from fpplab.phase.quality import coordinate_uncertainty
from fpplab.phase.saturation import LEAST_SAMPLES, MOST_LOSS
from fpplab.phase.unwrapping import EDGE_MARGIN_PX, WavelengthSequence, wavelength_sequence


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
    is_unambiguous : ndarray of bool
        The position lies in the projector and is told apart from its rival.
    """

    position: Floats
    disagreement: Floats
    second_best_order: NDArray[np.int64]
    is_unambiguous: NDArray[np.bool_]


def unwrap(
    phases: Floats,
    sequence: WavelengthSequence,
    sigma: float | Floats = 0.0,
    edge_margin: float = 0.0,
    changed_order: NDArray[np.int64] | None = None,
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

    Returns
    -------
    Unwrapped
        Positions, and how far they can be trusted.
    """
    turns, wavelengths = phases / TWO_PI, sequence.wavelengths
    measured = [np.tensordot(np.array(w.coefficients, np.float64), turns, axes=1) % 1.0 for w in wavelengths]
    period = 1.0 / wavelengths[0].stripes
    near = measured[0] * period
    other = near + np.where(measured[0] > 0.5, -period, period)
    chosen, cost_near = _refine(near, measured, sequence, changed_order)
    rival, cost_other = _refine(other, measured, sequence, changed_order)
    tolerance = edge_margin + EDGE_SIGMAS * np.asarray(sigma)
    apart = np.maximum(APART_LEAST, APART * (wavelengths[-1].stripes * np.asarray(sigma)) ** 2)
    far_near, far_other = (_beyond(p.position, tolerance) for p in (chosen, rival))
    swap = cost_other + far_other < cost_near + far_near
    alike = (np.abs(cost_near - cost_other) <= apart) & (far_near == 0) & (far_other == 0)
    inside = np.where(swap, far_other, far_near) == 0
    return Unwrapped(
        np.where(swap, rival.position, chosen.position),
        np.where(swap, rival.disagreement, chosen.disagreement),
        np.where(swap, rival.second_best_order, chosen.second_best_order),
        inside & ~alike,
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


def _beyond(position: Floats, tolerance: Floats) -> Floats:
    """A penalty above every cost for positions outside the projector; 0 inside."""
    outside = np.maximum(np.maximum(-position, position - 1.0), 0.0)
    return np.where(outside > tolerance, 100.0 + outside, 0.0)


def decode_axis(recording: Recording, axis: Axis) -> Map:
    """Decode one axis, without masks and without repair of orders.

    The compiled decoder (`fpplab.phase.decoding.decode`) must give the same wherever it gives anything.

    Parameters
    ----------
    recording : Recording
        Frames of a plan that codes the axis.
    axis : str
        Which axis, x or y.

    Returns
    -------
    ndarray of float32, (height, width)
        Projector coordinates in px, NaN where the order stays ambiguous.

    Raises
    ------
    ConfigError
        The plan cannot be unwrapped.
    """
    plan, length = recording.plan, axis_length(recording.projector_size, axis)
    sequence = wavelength_sequence(plan, axis, recording.name)
    errors = error_model_of(recording)
    sets = [wrapped_phase(recording.of_set(k), plan.fringes[k], errors.saturation) for k in sequence.sets]
    finest, fringe = sets[-1], plan.fringes[sequence.finest]
    offset = finest.offset.astype(np.float64) * recording.grey
    modulation = np.maximum(finest.modulation.astype(np.float64) * recording.grey, 1e-30)
    noise = fringe.phase_noise**2 * errors.noise.variance(offset) / modulation**2 * finest.loss
    common = np.nan_to_num(errors.sets[sequence.finest].variance(offset / modulation))
    sigma_px = coordinate_uncertainty(np.sqrt(noise + common), fringe.stripes, length)
    phases = np.array([one.phase for one in sets], np.float64)
    found = unwrap(phases, sequence, sigma_px / length, EDGE_MARGIN_PX / length)
    coordinate = np.where(found.is_unambiguous, found.position * length - 0.5, np.nan)
    return coordinate.astype(np.float32)
