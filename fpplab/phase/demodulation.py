"""Phases of fringe sets in plain NumPy, for any number of pixels, with their variances."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import TWO_PI, Floats, Map
from fpplab.core.errors import DataError
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.recording import Recording
from fpplab.phase.error_model import ErrorModel, misfit_limits
from fpplab.phase.limits import NOISE, ORDERS
from fpplab.phase.unwrapping import WavelengthSequence


@dataclass(frozen=True, eq=False)
class Wrapped:
    """One demodulated fringe set: maps [v, u], in the grey levels of its frames."""

    phase: Map  # of `2π stripes (u + 0.5)/W`, in [0, 2π) rad
    modulation: Map  # B
    offset: Map  # the mean
    misfit: Map  # RMS of what the fringe leaves
    peak: Map  # the greatest value in any frame that was used
    loss: Map  # variance of the phase relative to that from all samples


def wrapped_phase(
    frames: Sequence[NDArray[np.generic]], fringe: FringeSet, saturation: float = np.inf
) -> Wrapped:
    """Demodulate one fringe set: `φ = atan2(Σ I_n sin δ_n, Σ I_n cos δ_n)` less the phase origin."""
    # frames (height, width)
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
        _refit_saturated_pixels(levels, fringe.phase_shifts(), saturation, c, s, mean, square, peak, loss)
    modulation = np.hypot(s, c)
    misfit = np.sqrt(np.maximum(square - mean**2 - modulation**2 / 2.0, 0.0))
    phase = ((np.arctan2(s, c) - weights.origin_rad) % TWO_PI).astype(np.float32)
    # Rounding to float32 must not reach the end of the half-open interval.
    phase[phase >= np.float32(TWO_PI)] = 0.0
    return Wrapped(phase, *(m.astype(np.float32) for m in (modulation, mean, misfit, peak, loss)))


def _refit_saturated_pixels(
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
        if len(own) < NOISE.min_samples or np.linalg.matrix_rank(own) < 3:
            continue
        fitted = np.linalg.lstsq(own, values[used], rcond=None)[0]
        along = np.array([0.0, -fitted[2], fitted[1]]) / max(np.hypot(fitted[1], fitted[2]), 1e-30)
        variance = len(shift) / 2.0 * along @ np.linalg.inv(own.T @ own) @ along
        if variance > NOISE.max_saturation_loss:
            continue
        mean[pixel], c[pixel], s[pixel] = fitted
        rest = np.mean((values[used] - own @ fitted) ** 2)
        square[pixel] = rest + fitted[0] ** 2 + (fitted[1] ** 2 + fitted[2] ** 2) / 2.0
        peak[pixel], loss[pixel] = values[used].max(), variance


@dataclass(frozen=True, eq=False)
class AxisPhases:
    """What pixels of any shape (...) see of the K sets of one axis, fewest stripes first."""

    phases: Floats  # wrapped phases in rad
    noise: Floats  # variance of the position that each set gives
    common: Floats  # variance of the position that each set gives
    stripes: Floats  # of each set
    counted_share: float  # of `common` that counts for orders

    @property
    def position_sigma(self) -> Floats:
        """1-sigma of the position that each set gives, by both, (K, ...)."""
        return np.asarray(np.sqrt(self.noise + self.common))


def axis_phases(recording: Recording, sequence: WavelengthSequence, errors: ErrorModel) -> AxisPhases:
    fringes = [recording.plan.fringes[k] for k in sequence.sets]
    sets = [
        wrapped_phase(recording.of_set(k), f, errors.saturation)
        for k, f in zip(sequence.sets, fringes, strict=True)
    ]
    noises, commons = [], []
    for k, demodulated, fringe in zip(sequence.sets, sets, fringes, strict=True):
        level = demodulated.offset.astype(np.float64) * recording.grey
        modulation = np.maximum(demodulated.modulation.astype(np.float64) * recording.grey, 1e-30)
        per_level = errors.sets[k].scatter * fringe.phase_noise**2 * demodulated.loss / modulation**2
        repeated = errors.noise.repeated(level)
        variance = errors.noise.variance(level)
        per_freedom, surprising, explained = misfit_limits(errors.sets[k])
        observed = per_freedom * np.square(demodulated.misfit.astype(np.float64) * recording.grey)
        rounding = ORDERS.rest_rounding * (level**2 + modulation**2)
        is_surprising = observed > surprising * (variance + explained * modulation**2) + rounding
        excess = np.where(is_surprising, observed - variance, 0.0)
        own = per_level * (variance - repeated) / TWO_PI**2 + ORDERS.rounding_turns**2
        common = per_level * (repeated + excess) + errors.sets[k].variance(level / modulation)
        noises.append(own / fringe.stripes**2)
        # Where nothing shows the common errors, noise alone counts.
        commons.append(np.nan_to_num(common) / (TWO_PI * fringe.stripes) ** 2)
    return AxisPhases(
        np.array([demodulated.phase for demodulated in sets], np.float64),
        np.array(noises),
        np.array(commons),
        np.array([f.stripes for f in fringes]),
        errors.counted_share(sequence),
    )
