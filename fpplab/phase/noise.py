"""Noise of grey levels, found in the frames themselves by photon transfer.

The variance of a grey level is a linear function of the signal, `a + b I` (read-out noise and shot noise),
and contains the rounding to whole steps. Where noise is smaller than about a quarter of a step, a pixel that
is measured again is rounded the same way again: that part of the variance is common to all pixels of the same
level and phase (`repeated_rounding`), and no mean lessens it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtr, chdtri

from fpplab.core.conventions import Floats, Image
from fpplab.phase.limits import NOISE

QUANTISATION = 1 / 12
"""Variance of rounding to integers, in units of the last place squared: that of an even distribution."""


_f = np.float32
_FIRST, _SECOND = _f(1 / (2 * np.pi**2)), _f(1 / (8 * np.pi**2))
_HIGHER = _f(1 / 12 - 5 / (8 * np.pi**2))
_RATE, _ONE = _f(4 * np.pi**2 / 64), _f(1)


def repeated_rounding(spread: Floats) -> Floats:
    """Compute the part of a variance that repeats because values are rounded to whole steps."""
    # Noise of standard deviation s spreads a value over several steps, which leaves of the rounding error's
    # variance `Σ exp(-4π²k²s²)/(2π²k²)` as a function of the value alone: 1/12 without noise, nothing from
    # half a step on. The three terms here follow that sum within 0.001.
    # The power of a rational function is exp, but compiled to vector instructions.
    w = _ONE / (_ONE + _RATE * spread)
    w *= w
    w *= w
    w *= w
    w *= w
    w *= w
    w *= w
    w4 = w * w * w * w
    return _FIRST * w + _SECOND * w4 + _HIGHER * w4 * w4 * w  # type: ignore[no-any-return]


@dataclass(frozen=True)
class NoiseModel:
    """Variance of a grey level I: `constant + per_level * I`, in 8-bit grey levels squared."""

    constant: float  # variance at level 0 (read-out noise and rounding), in grey levels squared
    per_level: float  # increase of the variance per grey level (shot noise), in grey levels
    step: float = 1.0  # smallest difference of two levels of the frames, in grey levels

    def variance(self, level: Floats | float) -> Floats:
        return np.asarray(self.constant + self.per_level * np.asarray(level))

    @property
    def rounding_repeats(self) -> bool:
        """Whether noise is so small at some level that rounding repeats."""
        return bool(self.repeated(0.0) > NOISE.max_repeated_share * self.variance(0.0))

    def repeated(self, level: Floats | float) -> Floats:
        """Compute the part of the variance that is rounding and repeats in all pixels of the same light."""
        spread = self.variance(level) / self.step**2 - QUANTISATION
        return np.asarray(repeated_rounding(np.maximum(spread, NOISE.min_spread)) * self.step**2)


def level_step(values: Image) -> float:
    """Find the step of raw values: more than 1 where a container is deeper than its data."""
    # 8-bit data stored as multiples of 16 in 12 bits have a step of 16. Values that were scaled by no whole
    # number have steps of two neighbouring sizes, of which the mean is given.
    gaps = np.diff(np.flatnonzero(np.bincount(values.ravel())))
    if len(gaps) + 1 < NOISE.min_levels:
        return 1.0
    smallest = int(gaps.min())
    even = gaps <= smallest + (smallest > 1)
    return float(gaps[even].mean()) if smallest > 1 and even.mean() >= NOISE.min_even_share else 1.0


def fit_line(level: Floats, variance: Floats, freedom: int, step: float) -> NoiseModel:
    """Fit `a + b I` with a ≥ step²/12, b ≥ 0 through means over bins of equally many pixels."""
    # Pixels whose variance chance does not explain (motion, edges) are left out of their bin's mean. Bins
    # whose variance is less than that of rounding are undersampled, their levels do not change over a whole
    # step: they say nothing about noise and have no weight.
    # level (P,); variance (P,)
    floor = QUANTISATION * step**2
    bins = max(1, min(NOISE.max_bins, len(level) // NOISE.min_pixels_per_bin))
    order = np.argsort(level)[len(level) % bins :].reshape(bins, -1)
    centre, mean = level[order].mean(axis=1), robust_mean(variance[order], freedom, floor)
    sampled = mean >= NOISE.min_sampled_share * floor
    if not sampled.any():
        return NoiseModel(floor, 0.0, step)
    # Means scatter in proportion to the variance itself.
    weight = 1.0 / np.maximum(mean[sampled], floor)
    design = np.stack([np.ones(sampled.sum()), centre[sampled]], axis=1) * weight[:, None]
    constant, per_level = _not_negative(design, np.maximum(mean[sampled] - floor, 0.0) * weight)
    return NoiseModel(floor + float(constant), float(per_level), step)


def _not_negative(design: Floats, values: Floats) -> Floats:
    """Solve least squares for two unknowns of which none is negative."""
    alone = np.maximum(design.T @ values, 0.0) / np.square(design).sum(axis=0)
    solutions = [np.linalg.lstsq(design, values, rcond=None)[0], np.diag(alone)[0], np.diag(alone)[1]]
    allowed = [each for each in solutions if each.min() >= 0.0]
    return min(allowed, key=lambda each: float(np.linalg.norm(design @ each - values)))


def surprising_power(freedom: int) -> float:
    """Give what a pixel's residuals hardly ever exceed by chance, mean squares in units of the variance."""
    return float(chdtri(freedom, NOISE.surprising_share)) / freedom


def robust_mean(variance: Floats, freedom: int, floor: float) -> Floats:
    """Average variances, leaving out those that chance does not explain."""
    # variance (..., P)
    cut = float(chdtri(freedom, NOISE.rejected_share)) / freedom
    # Mean of χ²/ν below the cut: the distribution of two more degrees of freedom.
    kept_mean = float(chdtr(freedom + 2, cut * freedom)) / (1.0 - NOISE.rejected_share)
    mean = np.median(variance, axis=-1) / (float(chdtri(freedom, 0.5)) / freedom)
    for _ in range(NOISE.rejection_passes):
        inside = variance <= cut * np.maximum(mean, floor)[..., None]
        count = inside.sum(axis=-1)
        total = np.where(inside, variance, 0.0).sum(axis=-1) / kept_mean
        mean = np.where(count > 0, total / np.maximum(count, 1), floor)
    return np.asarray(mean)
