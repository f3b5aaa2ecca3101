"""The errors of a recording's grey levels and phases, estimated from a sparse sample of its pixels.

Two kinds are distinguished. Noise is independent from pixel to pixel, and averaging lessens it. What the
response, the lamp and rounding do is the same for all pixels of one phase (`fpplab.phase.common_errors`,
`fpplab.phase.noise.repeated_rounding`), and averaging does not lessen it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from fpplab.core.conventions import (
    TWO_PI,
    Axis,
    Floats,
    Image,
    Mask,
    axis_length,
    full_scale,
    raw_per_grey,
)
from fpplab.core.errors import ConfigError
from fpplab.core.remembered import remembered
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.recording import MergedLevels, Recording
from fpplab.patterns.unwrapping import SyntheticWavelength
from fpplab.phase.common_errors import (
    CommonErrors,
    FringeGroup,
    HarmonicsFit,
    errors_of_sets,
    fit_group,
    groups_of,
    noise_power,
)
from fpplab.phase.drift import PointingDrift, phase_ramp, pointing_drifts, ramp_error_rad, without_ramp
from fpplab.phase.lag import lag_error_rad, lag_share, without_lag
from fpplab.phase.limits import NOISE, ORDERS
from fpplab.phase.neighbours import noise_of_neighbours, with_errors_of_neighbours
from fpplab.phase.noise import QUANTISATION, NoiseModel, fit_line, level_step, surprising_power
from fpplab.phase.unwrapping import WavelengthSequence, wavelength_sequence


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """Errors of a recording."""

    noise: NoiseModel  # of the grey levels
    sets: tuple[CommonErrors, ...]  # of each fringe set
    saturation: int  # raw value from which on a sample is saturated
    lag: float = 0.0  # share of the frame before that is left in each frame
    drifts: Mapping[Axis, PointingDrift] = field(default_factory=dict)  # of the projector's picture

    @property
    def phase_error_is_known(self) -> bool:
        """Whether the frames show the common errors: fringe sets that show them, and enough pixels."""
        return all(np.isfinite(errors.terms).all() for errors in self.sets)

    def of_sets(self, start: int | None, stop: int | None) -> ErrorModel:
        """Give the errors of some of the sets, as a slice."""
        return replace(self, sets=self.sets[start:stop])

    def counted_share(self, sequence: WavelengthSequence) -> float:
        """Give the share of the variance by common errors that counts for the orders of one axis."""
        peaks = [math.sqrt(2.0) * float(np.nan_to_num(self.sets[k].harmonic_rad)) for k in sequence.sets]

        def height(wavelength: SyntheticWavelength) -> float:
            return float(np.abs(wavelength.coefficients) @ peaks) / TWO_PI

        for coarse, fine in pairwise(sequence.wavelengths):
            if height(coarse) * fine.stripes / coarse.stripes + height(fine) > ORDERS.max_wave_turns:
                return 1.0
        return ORDERS.bounded_share


def misfit_limits(errors: CommonErrors) -> tuple[float, float, float]:
    """When a pixel's own residuals tell its variance, and how."""
    # The variance of a grey level by the mean square of what a fringe leaves; what this exceeds, in units of
    # the expected one; what of that is explained by gains and harmonics, over B². It is never exceeded where
    # images show nothing beside a fringe.
    freedom = errors.images - 3
    if freedom <= 0:
        return 0.0, 1.0, 0.0
    # What is explained depends on the phase: at most twice the mean.
    return (
        errors.images / (freedom * errors.misfit_scatter),
        surprising_power(freedom),
        2.0 * errors.explained,
    )


@remembered
def error_model_of(recording: Recording) -> ErrorModel:
    plan, samples = recording.plan, _sampled_levels_by_set(recording)
    usable = _find_usable_pixels(samples, full_scale(recording.bits))
    drifts = pointing_drifts([sample[:, usable] for sample in samples], recording)
    sizes = [axis_length(recording.projector_size, fringe.axis) for fringe in plan.fringes]
    ramps = {
        k: phase_ramp(drifts[fringe.axis], fringe, size)
        for k, (fringe, size) in enumerate(zip(plan.fringes, sizes, strict=True))
        if fringe.axis in drifts
    }
    errors, fits = fit_errors(
        samples,
        plan.fringes,
        recording.bits,
        plan.masks.modulation_min,
        recording.harmonics,
        _sequences(recording),
        ramps,
        recording.merged,
    )
    if plan.images <= NOISE.min_samples:
        noise = noise_of_neighbours(recording, errors.saturation, errors.noise)
        errors = replace(errors, noise=noise)
    sets = list(with_errors_of_neighbours(errors.sets, recording, errors.saturation, fits, errors.noise))
    for k, ramp in ramps.items():
        sets[k] = replace(sets[k], drift_rad=ramp_error_rad(ramp, plan.fringes[k]))
    return replace(errors, sets=tuple(sets), drifts=drifts)


def _sequences(recording: Recording) -> list[WavelengthSequence]:
    """How the axes are unwrapped; none where that needs a calibration."""
    try:
        axes = recording.plan.unwrapped_axes
        return [wavelength_sequence(recording.plan, axis, recording.name) for axis in axes]
    except ConfigError:
        return []


def _sampled_levels_by_set(recording: Recording) -> list[Image]:
    """A sparse sample of pixels of each set, (N, P): whole cache lines of a few rows."""
    height, width = recording.frames[0].shape
    rows = max(1, height // NOISE.sample_rows)
    columns = max(1, height // rows * width // NOISE.sample_pixels)
    picked = np.stack([f[rows // 2 :: rows, ::columns].ravel() for f in recording.frames])
    return [picked[a:b] for a, b in pairwise(recording.plan.set_starts)]


def fit_errors(
    samples: Sequence[Image],
    fringes: Sequence[FringeSet],
    bits: int,
    modulation_min: float = 0.0,
    harmonics: Floats | None = None,
    sequences: Sequence[WavelengthSequence] = (),
    ramps: Mapping[int, Floats] = MappingProxyType({}),
    merged: MergedLevels | None = None,
) -> tuple[ErrorModel, dict[int, HarmonicsFit]]:
    """Estimate noise by photon transfer, beyond harmonics and flicker; robust against scene and motion."""
    # Where a set has more than three steps, noise is what the sinusoid leaves. Where all have three, it is
    # the difference between the sets' offsets. One set of three steps does not reveal the noise: the model is
    # then the rounding alone, a lower bound. Beside the model, the fits of sets that are fitted by
    # themselves.
    # samples (N, P); harmonics (K,)
    step = level_step(np.concatenate([sample.ravel() for sample in samples]))
    grey = (merged.headroom if merged else 1.0) / raw_per_grey(bits)
    saturation = _saturation(bits, step)
    usable = np.flatnonzero(_find_usable_pixels(samples, saturation))
    freedom = sum(fringe.images - 3 for fringe in fringes) or len(fringes) - 1
    usable = usable[:: max(1, len(usable) * freedom // NOISE.max_values)]
    levels = [grey * sample[:, usable].astype(np.float64) for sample in samples]
    lag = lag_share(levels, fringes, modulation_min)
    # What the frames before leave looks like flicker and noise.
    levels = without_lag(levels, lag)
    for k, ramp in ramps.items():  # so does a picture that walks
        levels[k] = without_ramp(levels[k], fringes[k], ramp)
    groups = groups_of(levels, fringes, modulation_min)
    fits = [fit_group(group) for group in groups]
    noise = _fit_noise_model(groups, fits, step * grey)
    if merged:
        noise = NoiseModel(*merged.noise, step * grey)
    elif not groups:
        noise = _noise_beside_saturation(samples, fringes, saturation, grey, step) or noise
    sets = [
        replace(errors, lag_rad=lag_error_rad(lag, fringe))
        for errors, fringe in zip(
            errors_of_sets(groups, fits, fringes, harmonics, sequences), fringes, strict=True
        )
    ]
    model = ErrorModel(noise, tuple(sets), saturation, lag)
    single = zip(groups, fits, strict=True)
    return model, {group.members[0]: fit for group, fit in single if len(group.members) == 1}


def _saturation(bits: int, step: float) -> int:
    return math.floor(full_scale(bits) - step) + 1


def saturation_of(recording: Recording) -> int:
    """Give the raw value from which on a sample is saturated."""
    return _saturation(recording.bits, level_step(np.stack([f.reshape(-1)[::64] for f in recording.frames])))


def _find_usable_pixels(samples: Sequence[Image], saturation: int) -> Mask:
    """Pixels that no image shows saturated or, unless too few remain, black: clipped, they scatter less."""
    lowest = np.min([s.min(axis=0) for s in samples], axis=0)
    bright: Mask = np.max([s.max(axis=0) for s in samples], axis=0) < saturation
    both: Mask = bright & (lowest > 0)
    return both if both.sum() >= NOISE.min_pixels else bright


def _fit_noise_model(groups: Sequence[FringeGroup], fits: Sequence[HarmonicsFit], step: float) -> NoiseModel:
    """The line through the variances of the pixels, of all their images together."""
    parts = [noise_power(group, fit) for group, fit in zip(groups, fits, strict=True)]
    if not parts:
        return NoiseModel(QUANTISATION * step**2, 0.0, step)
    freedom = sum(own for _, own in parts)
    variance = np.sum([power for power, _ in parts], axis=0) / freedom
    return fit_line(np.mean([g.offset for g in groups], axis=0), variance, freedom, step)


def _noise_beside_saturation(
    samples: Sequence[Image], fringes: Sequence[FringeSet], saturation: int, grey: float, step: float
) -> NoiseModel | None:
    """The line through what sinusoids leave of unsaturated samples, where every pixel has saturated ones."""
    pixels = samples[0].shape[1]
    power, freedom, level = np.zeros(pixels), np.zeros(pixels), np.zeros(pixels)
    for sample, fringe in zip(samples, fringes, strict=True):
        shift, used = fringe.phase_shifts(), sample < saturation
        waves = np.stack([np.ones_like(shift), np.cos(shift), np.sin(shift)], axis=1)
        values, weight = sample * grey, used.astype(np.float64)
        normal = np.einsum("np,ni,nj->pij", weight, waves, waves)
        fitted = np.linalg.pinv(normal) @ np.einsum("np,ni->pi", weight * values, waves)[:, :, None]
        rest = weight * (values - np.einsum("ni,pi->np", waves, fitted[:, :, 0]))
        enough = used.sum(axis=0) > NOISE.min_samples
        power += np.where(enough, (rest**2).sum(axis=0), 0.0)
        freedom += np.where(enough, used.sum(axis=0) - NOISE.min_samples, 0)
        level += (weight * values).sum(axis=0) / np.maximum(used.sum(axis=0), 1) / len(fringes)
    measured = freedom > 0
    if measured.sum() < NOISE.min_pixels:
        return None
    typical = round(float(np.median(freedom[measured])))
    return fit_line(level[measured], power[measured] / freedom[measured], max(typical, 1), step * grey)
