"""Frames of several exposures become one frame for each pattern, with the noise of a camera's frame.

A pixel sees the level `black + s x` in an exposure of relative length s, of light x. Its samples of one
pattern are averaged with the inverse of their variances, `(constant + per_level s x) / s²`; saturated samples
are left out one by one. The mean is then given that scale, common to all patterns of the pixel, at which a
camera's level has the variance of the mean. So everything that decodes, checks and judges frames of one
exposure, with noise as a line over the level, holds for merged frames too. A pattern without any sample is
saturated.

Black, the exposures' true ratios and the noise follow from the frames: exposures of the same light must
agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core import buffers
from fpplab.core.conventions import Floats, Image, full_scale, raw_per_grey
from fpplab.core.errors import DataError
from fpplab.patterns.recording import MergedLevels, Recording
from fpplab.phase.chunks import compiled, compiled_part
from fpplab.phase.limits import EXPOSURES, NOISE
from fpplab.phase.noise import QUANTISATION, NoiseModel, fit_line, level_step

_BLOCK = 30_000  # pixels that one thread merges at a time (chosen: no power of two, which caches dislike)
_BITS = 16  # depth of merged frames
_MISSING = full_scale(_BITS)


@dataclass(frozen=True, eq=False)
class ExposureModel:
    """How the levels of a camera answer to light, in its raw levels."""

    black: float  # level without light
    shares: Floats  # light that each exposure collects, as a share of that of the longest
    noise: NoiseModel  # of a raw level, by how much it is above black
    saturation: float  # level from which on a sample is saturated

    @property
    def offset(self) -> float:
        """Level that merged frames have without light, so that noise does not fall below 0."""
        # Not above the level at which the line of the noise, seen from it, still begins above 0.
        return min(max(self.black, 0.0), 0.5 * self.noise.constant / max(self.noise.per_level, 1e-12))


def merged_recording(recording: Recording, exposures_s: Sequence[float]) -> Recording:
    """Merge the frames of a plan taken at several exposures, one plan after another; one stays as it is."""
    if len(exposures_s) == 1:
        return recording
    plan = recording.plan
    groups = {each: k for k, each in enumerate(dict.fromkeys(plan.exposures_by_set))}
    by_set = [groups[each] for each in plan.exposures_by_set]
    by_image = np.repeat(by_set, np.diff(plan.set_starts))
    frames = _with_gaps(recording, len(exposures_s))
    frames, levels, _ = merge_frames(frames, recording.bits, exposures_s, recording.name, by_image)
    levels = replace(levels, scales=tuple(levels.scales[k] for k in by_set))
    return replace(recording, frames=frames, bits=_BITS, merged=levels)


def _with_gaps(recording: Recording, exposures: int) -> Sequence[Image]:
    """All images at all exposures: those that were not taken count as saturated."""
    plan, frames = recording.plan, recording.frames
    if len(frames) == plan.images * exposures:
        return frames
    if len(plan.passes) != exposures or len(frames) != plan.frames:
        raise DataError(
            f"{recording.name}: holds {len(frames)} frames, but the plan takes {plan.images} at each of "
            f"{exposures} exposures; give all of them"
        )
    gap = np.full_like(frames[0], full_scale(recording.bits))
    taken = iter(frames)
    return [next(taken) if i in images else gap for images in plan.passes for i in range(plan.images)]


def merge_frames(
    frames: Sequence[Image],
    bits: int,
    exposures_s: Sequence[float],
    name: str,
    groups: NDArray[np.intp] | None = None,
) -> tuple[list[Image], MergedLevels, ExposureModel]:
    """Merge the frames of several exposures, those of one after those of another, into frames of 16 bits."""
    # groups (N,): images that share a scale; by default all
    model = exposure_model(frames, bits, exposures_s, name)
    (height, width), shown = frames[0].shape, len(frames) // len(exposures_s)
    groups = np.zeros(shown, np.intp) if groups is None else groups
    merged = buffers.empty((shown, height * width), np.uint16)
    scales = buffers.empty((int(groups.max()) + 1, height * width), np.float32)
    flat = [frame.reshape(-1) for frame in frames]
    unit = 2.0 ** (_BITS - bits) / EXPOSURES.headroom
    line, offset = (model.noise.constant, model.noise.per_level), model.offset
    camera = (model.shares, model.black, *line, model.saturation, offset, unit)

    def merge(start: int) -> None:
        part = slice(start, start + _BLOCK)
        levels = np.stack([frame[part] for frame in flat]).reshape(len(exposures_s), shown, -1)
        _merge(levels, camera, groups, merged[:, part], scales[:, part])

    with ThreadPoolExecutor() as pool:
        list(pool.map(merge, range(0, height * width, _BLOCK)))
    grey = 1.0 / raw_per_grey(bits)
    noise = grey**2 * (line[0] - line[1] * offset), grey * line[1]
    of_light = MergedLevels(EXPOSURES.headroom, tuple(scales.reshape(-1, height, width)), noise)
    return [frame.reshape(height, width) for frame in merged], of_light, model


@compiled
def _merge(levels: Any, camera: Any, groups: Any, merged: Any, scales: Any) -> None:
    # levels (J, N, P) raw; groups (N,); merged (N, P); scales (G, P)
    shares, black, constant, per_level, saturation, offset, unit = camera
    exposures, patterns, pixels = levels.shape
    mean, variance, weights = np.empty(patterns), np.empty(patterns), np.empty(exposures)
    masks = np.empty((len(scales), patterns), np.bool_)
    for g in range(len(scales)):
        masks[g] = groups == g
    for p in range(pixels):
        light, collected = 0.0, 0.0
        for j in range(exposures):
            for n in range(patterns):
                if levels[j, n, p] < saturation:
                    light += levels[j, n, p] - black
                    collected += shares[j]
        light = max(light / max(collected, 1e-30), 0.0)
        for j in range(exposures):
            weights[j] = shares[j] * shares[j] / (constant + per_level * shares[j] * light)
        for n in range(patterns):
            weight, moment, fixed, rising = 0.0, 0.0, 0.0, 0.0
            for j in range(exposures):
                if levels[j, n, p] < saturation:
                    relative = weights[j] / shares[j]
                    weight += weights[j]
                    moment += relative * (levels[j, n, p] - black)
                    fixed += relative * relative * constant
                    rising += relative * weights[j] * per_level
            mean[n], variance[n] = 0.0, np.inf
            if weight > 0.0:
                mean[n] = moment / weight
                variance[n] = (fixed + rising * max(mean[n], 0.0)) / (weight * weight)
        for g in range(len(scales)):
            factor = _factor(mean, variance, masks[g], camera)
            scales[g, p] = factor
            for n in range(patterns):
                if masks[g, n]:
                    level = unit * (factor * mean[n] + offset) if np.isfinite(variance[n]) else _MISSING
                    merged[n, p] = np.uint16(max(np.rint(level), 0.0))


@compiled_part
def _factor(mean: Any, variance: Any, chosen: Any, camera: Any) -> float:
    """The scale at which a level of the camera has the variance of the means."""
    _, _, constant, per_level, _, offset, unit = camera
    low, high, total, count = np.inf, -np.inf, 0.0, 0
    for n in range(len(mean)):
        if chosen[n] and np.isfinite(variance[n]):
            low, high = min(low, mean[n]), max(high, mean[n])
            total += mean[n]
            count += 1
    if count == 0:
        return 1.0
    spread = _spread(mean, variance, chosen, 0.5 * (low + high), 0.5 * (high - low))
    rising = per_level * max(total / count, 0.0)
    factor = 0.5 * (rising + np.sqrt(rising * rising + 4.0 * spread * constant)) / spread
    if unit * (factor * high + offset) > _MISSING - 1:
        factor = ((_MISSING - 1) / unit - offset) / high
    return float(factor)


@compiled_part
def _spread(mean: Any, variance: Any, chosen: Any, offset: float, amplitude: float) -> float:
    """Variance of the levels as it counts for a phase: those at crests and troughs say nothing of it."""
    total, counted = 0.0, 0.0
    for n in range(len(mean)):
        if chosen[n] and np.isfinite(variance[n]):
            away = (mean[n] - offset) / max(amplitude, 1e-30)
            weight = max(1.0 - away * away, EXPOSURES.min_slope)
            total += weight * variance[n]
            counted += weight
    return total / counted


def exposure_model(
    frames: Sequence[Image], bits: int, exposures_s: Sequence[float], name: str
) -> ExposureModel:
    """Find black, true ratios and noise from pixels that several exposures show unsaturated."""
    samples = _samples(frames, len(exposures_s))
    step = level_step(samples)
    saturation = np.floor(full_scale(bits) - step) + 1
    order = np.argsort(exposures_s)
    pairs = [_Pair.of(samples[i], samples[j], saturation) for i, j in pairwise(order)]
    nominal = [exposures_s[i] / exposures_s[j] for i, j in pairwise(order)]
    grey = 2.0 ** (bits - 8)
    black, ratios = _black_and_ratios(pairs, nominal, grey, step)
    for pair, ratio, expected in zip(pairs, ratios, nominal, strict=True):
        if abs(ratio / expected - 1.0) > EXPOSURES.max_ratio_error or not pair.is_linear(black, ratio, step):
            raise DataError(
                f"{name}: between exposures whose times have the ratio {expected:.4g}, levels have "
                f"the ratio {ratio:.4g}, or none: merging needs levels in proportion to light; switch the "
                "camera's gamma and automatic gain off, and let nothing change during the measurement"
            )
    shares = np.empty(len(exposures_s))
    shares[order] = np.cumprod([1.0, *ratios[::-1]])[::-1]
    return ExposureModel(black, shares, _noise(pairs, ratios, black, step), float(saturation))


def _samples(frames: Sequence[Image], exposures: int) -> Image:
    """Pairs of neighbouring pixels, spread over the image, (J, N, P, 2)."""
    height, width = frames[0].shape
    rows = max(1, height // NOISE.sample_rows)
    columns = 2 * max(1, height // rows * width // (2 * NOISE.sample_pixels))
    used = width - 1
    first = [f[rows // 2 :: rows, :used:columns].ravel() for f in frames]
    beside = [f[rows // 2 :: rows, 1::columns].ravel() for f in frames]
    picked = np.stack([first, beside], axis=-1)
    paired: Image = picked.reshape(exposures, -1, *picked.shape[1:])
    return paired


@dataclass(frozen=True, eq=False)
class _Pair:
    """Samples that a shorter and the next longer exposure show unsaturated, and means over bins of them."""

    short: Floats  # (K,) raw levels
    long: Floats  # (K,)
    means: Floats  # (B, 2) of short and long
    count: Floats  # (B,) samples of each bin

    @classmethod
    def of(cls, short: Image, long: Image, saturation: float) -> _Pair:
        # Bins are by the neighbouring pixel, whose noise is another: those by a sample's own level would have
        # the mean of its noise.
        beside = long[..., 1]
        used = (long[..., 0] < saturation) & (beside < EXPOSURES.max_level * saturation)
        used &= short[..., 0] < saturation  # as images seem that the shorter one did not take
        levels = short[..., 0][used].astype(np.float64), long[..., 0][used].astype(np.float64)
        bins = (EXPOSURES.bins / (EXPOSURES.max_level * saturation) * beside[used]).astype(np.intp)
        parts = [np.flatnonzero(bins == k) for k in range(EXPOSURES.bins)]
        parts = [part for part in parts if len(part) >= NOISE.min_pixels_per_bin]
        # Noise that is cut off at zero has another mean.
        whole = [part for part in parts if (levels[0][part] == 0).mean() < EXPOSURES.max_black_share]
        means = np.array([[level[part].mean() for level in levels] for part in whole]).reshape(-1, 2)
        return cls(*levels, means, np.array([float(len(part)) for part in whole]))

    def is_linear(self, black: float, ratio: float, step: float) -> bool:
        if len(self.count) < 2:
            return True
        rest, highest = self.means @ [1.0, -ratio] - (1.0 - ratio) * black, self.means[:, 0].max() - black
        return bool(np.sqrt(np.mean(rest**2)) <= EXPOSURES.max_misfit * highest + 0.5 * step)


def _black_and_ratios(
    pairs: Sequence[_Pair], nominal: Sequence[float], grey: float, step: float
) -> tuple[float, Floats]:
    """Least squares of `short - black = ratio (long - black)`, beside what is expected of both."""
    expected = np.array([0.0, *nominal])
    spread = np.array([EXPOSURES.black_prior * grey, *(EXPOSURES.ratio_prior * np.array(nominal))])
    fitted = expected.copy()
    for _ in range(EXPOSURES.fit_passes):
        rows, rest = [np.diag(1.0 / spread)], [(expected - fitted) / spread]
        black = fitted[0]
        for k, (pair, ratio) in enumerate(zip(pairs, fitted[1:], strict=True), start=1):
            # Where noise is small, a level is rounded the same way every time.
            weight = 1.0 / np.sqrt(grey**2 / pair.count + QUANTISATION * step**2)
            short, long = (pair.means - black).T
            slopes = np.zeros((len(weight), len(fitted)))
            slopes[:, 0], slopes[:, k] = weight * (1.0 - ratio), weight * long
            rows.append(slopes)
            rest.append(weight * (short - ratio * long))
        fitted = fitted + np.linalg.lstsq(np.concatenate(rows), np.concatenate(rest), rcond=None)[0]
    return float(fitted[0]), fitted[1:]


def _noise(pairs: Sequence[_Pair], ratios: Floats, black: float, step: float) -> NoiseModel:
    """The line through the variances of what two exposures of the same light differ by."""
    levels, variances = [], []
    for pair, ratio in zip(pairs, ratios, strict=True):
        short, long = pair.short - black, pair.long - black
        size = 1.0 + ratio**2
        # The likeliest light, whose noise is independent of the difference.
        light = ratio * (ratio * short + long) / size
        levels.append((1.0 + ratio) * light / size)
        variances.append((short - ratio * long) ** 2 / size)
    level, variance = np.concatenate([*levels, np.empty(0)]), np.concatenate([*variances, np.empty(0)])
    if level.size < NOISE.min_pixels:
        return NoiseModel(QUANTISATION * step**2, 0.0, step)
    # Equally many of all levels, where there are: a dark background would leave a single bin for the scene.
    ranges = (EXPOSURES.bins * level / level.max()).astype(np.intp)
    even = np.concatenate(
        [np.flatnonzero(ranges == k)[: EXPOSURES.max_in_bin] for k in range(EXPOSURES.bins)]
    )
    return fit_line(level[even], variance[even], 1, step)
