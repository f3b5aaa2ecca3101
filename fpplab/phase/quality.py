"""Which pixels are measured, and how well: masks, intensity noise, uncertainty.

The noise of a pixel is estimated from the frames themselves by photon transfer: its variance is a linear
function of the signal, `a + b I` (read-out noise and shot noise). Phase noise follows as `u_φ = √2/√(M N) ·
u_I/B` for N steps of M frames each, and the coordinate's as `u_φ W/(2π stripes)`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import nnls

from fpplab.core.conventions import TWO_PI, Floats, Mask, full_scale
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.plan import MaskRules
from fpplab.patterns.recording import Recording

QUANTISATION = 1 / 12
"""Variance of rounding to integers, in units of the last place squared."""

_BINS = 24
_LEAST_PER_BIN = 30
_LEAST_PIXELS = 100
_SAMPLE_ROWS, _SAMPLE_PIXELS = 32, 16_000


@dataclass(frozen=True)
class NoiseModel:
    """Variance of a grey level I: `constant + per_level * I`, in 8-bit grey levels squared.

    Attributes
    ----------
    constant : float
        Variance at level 0 (read-out noise and rounding), in grey levels squared.
    per_level : float
        Increase of the variance per grey level (shot noise), in grey levels.
    """

    constant: float
    per_level: float

    def variance(self, level: Floats | float) -> Floats:
        """Compute the variance at the given levels.

        Parameters
        ----------
        level : float or ndarray of float64
            8-bit grey levels.

        Returns
        -------
        ndarray of float64
            Variance in grey levels squared, of the same shape.
        """
        return np.asarray(self.constant + self.per_level * np.asarray(level))


def phase_uncertainty(
    noise: float | Floats, modulation: float | Floats, steps: int, repeats: int = 1
) -> Floats:
    """Compute the standard uncertainty of the phase, `u_φ = √2/√(M N) · u_I/B`.

    Parameters
    ----------
    noise : float or ndarray of float64
        Standard deviation u_I of a grey level.
    modulation : float or ndarray of float64
        Fringe amplitude B, in the same grey levels.
    steps : int
        Number N of steps.
    repeats : int
        Number M of frames per step.

    Returns
    -------
    ndarray of float64
        In rad.
    """
    return np.asarray(np.sqrt(2.0 / (repeats * steps)) * np.asarray(noise) / np.asarray(modulation))


def coordinate_uncertainty(phase_sigma: float | Floats, stripes: float, length: int) -> Floats:
    """Compute the standard uncertainty of a projector coordinate, `u_φ W/(2π stripes)`.

    Parameters
    ----------
    phase_sigma : float or ndarray of float64
        Standard uncertainty of its phase in rad.
    stripes : float
        Number of stripes of the fringe set.
    length : int
        Length W of the projector along the axis, in px.

    Returns
    -------
    ndarray of float64
        In projector px.
    """
    return np.asarray(np.asarray(phase_sigma) * length / (TWO_PI * stripes))


def measurable(
    modulation: Floats,
    offset: Floats,
    misfit: Floats,
    peak: Floats,
    rules: MaskRules,
    full_scale: float,
) -> Mask:
    """Find the pixels where one fringe set satisfies the mask rules.

    Parameters
    ----------
    modulation : ndarray of float64
        Fringe amplitude B, in 8-bit grey levels.
    offset : ndarray of float64
        Mean level, in 8-bit grey levels.
    misfit : ndarray of float64
        RMS residual of the sinusoid, in 8-bit grey levels.
    peak : ndarray of float64
        Greatest raw value of the set's frames; a pixel that reached `full_scale` in any of them is saturated.
    rules : MaskRules
        Of the plan.
    full_scale : float
        Raw value of a saturated pixel.

    Returns
    -------
    ndarray of bool
        Where the pixel is measured, of the maps' shape.
    """
    return np.asarray(
        (modulation > 0)
        & (modulation >= rules.modulation_min)
        & (modulation >= rules.contrast_min * offset)
        & (misfit <= rules.residual_max * modulation)
        & (peak < full_scale)
    )


def noise_of(recording: Recording) -> NoiseModel:
    """Fit the noise of a recording, from a sparse sample of its pixels.

    Parameters
    ----------
    recording : Recording
        All frames of a plan.

    Returns
    -------
    NoiseModel
        In 8-bit grey levels.
    """
    samples, plan = _sample(recording), recording.plan
    return fit_noise(samples, plan.fringes, full_scale(recording.bits), recording.grey)


def _sample(recording: Recording) -> list[Floats]:
    """A sparse sample of pixels of each set, (N, P): whole cache lines of a few rows."""
    height, width = recording.frames[0].shape
    rows = max(1, height // _SAMPLE_ROWS)
    columns = max(1, height // rows * width // _SAMPLE_PIXELS)
    picked = [f[rows // 2 :: rows, ::columns].ravel() for f in recording.frames]
    sampled = np.stack(picked).astype(np.float64)
    return [sampled[a:b] for a, b in pairwise(recording.plan.set_starts)]


def fit_noise(
    samples: Sequence[Floats], fringes: Sequence[FringeSet], saturation: float, grey: float
) -> NoiseModel:
    """Fit the noise model by photon transfer, robust against scene and motion.

    Where a set has more than three steps, noise is the residual of its sinusoid, and of the second and third
    harmonic too where there are steps enough (a nonlinear response is not noise). Where all have three, it is
    the difference between the sets' offsets. One set of three steps does not reveal the noise: the model is
    then the rounding alone, a lower bound.

    Parameters
    ----------
    samples : sequence of ndarray of float64, (N, P)
        Raw values of each fringe set, of the same P pixels in all.
    fringes : sequence of FringeSet
        The sets that the samples are of.
    saturation : float
        Raw value at which a pixel is saturated.
    grey : float
        8-bit grey levels per raw unit.

    Returns
    -------
    NoiseModel
        In 8-bit grey levels.
    """
    floor = QUANTISATION * grey**2
    lowest = np.min([s.min(axis=0) for s in samples], axis=0)
    highest = np.max([s.max(axis=0) for s in samples], axis=0)
    usable = (lowest > 0) & (highest < saturation)
    if usable.sum() < _LEAST_PIXELS:
        # Dark pixels clip at zero and scatter less; better than none.
        usable = highest < saturation
    variance, freedom = _scatter([s[:, usable] for s in samples], fringes)
    if freedom == 0 or usable.sum() < _LEAST_PIXELS:
        return NoiseModel(floor, 0.0)
    level = np.mean([s[:, usable].mean(axis=0) for s in samples], axis=0) * grey
    return _fit_line(level, variance * grey**2 / _median_of_chi2(freedom), floor)


def _scatter(samples: Sequence[Floats], fringes: Sequence[FringeSet]) -> tuple[Floats, int]:
    """Variance of each pixel in raw units squared, (P,), and its degrees of freedom."""
    left = [fringe.noise_power(sample) for fringe, sample in zip(fringes, samples, strict=True)]
    freedom = sum(own for _, own in left)
    if freedom:
        return np.sum([power for power, own in left if own], axis=0) / freedom, freedom
    offsets = np.array([s.mean(axis=0) for s in samples])
    freedom = len(samples) - 1
    squares = 3.0 * ((offsets - offsets.mean(axis=0)) ** 2).sum(axis=0)
    return squares / max(freedom, 1), freedom


def _median_of_chi2(freedom: int) -> float:
    """Median of χ²/ν with ν degrees of freedom (Wilson and Hilferty)."""
    return float((1.0 - 2.0 / (9.0 * freedom)) ** 3)


def _fit_line(level: Floats, variance: Floats, floor: float) -> NoiseModel:
    """`a + b I` with a ≥ floor, b ≥ 0 through the medians of bins of equally many pixels."""
    bins = max(1, min(_BINS, len(level) // _LEAST_PER_BIN))
    order = np.array_split(np.argsort(level), bins)
    centre = np.array([level[i].mean() for i in order])
    median = np.array([np.median(variance[i]) for i in order])
    # Medians scatter in proportion to the variance itself.
    weight = 1.0 / np.maximum(median, floor)
    design = np.stack([np.ones(bins), centre], axis=1) * weight[:, None]
    (constant, per_level), _ = nnls(design, np.maximum(median - floor, 0.0) * weight)
    return NoiseModel(floor + float(constant), float(per_level))
