"""Light of the bench that changes from frame to frame: flicker of the projector, and rolling bands.

Both are told by the bench's frames alone, by what lies outside of offset and fringe. Frame n of a set is

    (1 + ε_n + d_n·∇A/A) (A + B cos θ_n) - κ_n B sin θ_n + A ρ_n cos(2π f r + φ_n)

with the projector's light ε_n, a shift d_n of the print and κ_n of the fringe by motion, and a wave along the
rows r: light on the mains as a rolling shutter sees it. A, B and θ differ from pixel to pixel, so that least
squares over many thousands of them find the few numbers of a frame. Flicker and bands are the further
variances of ε_n and ρ_n beyond noise, taken where Schwarz's criterion asks for them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import minimize_scalar

from fpplab.core.conventions import Floats, PixelIndices, raw_per_grey
from fpplab.matching.loss import board_mask, subsample_pixels
from fpplab.matching.reference import Reference
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.phase.common_errors import fit_sinusoids
from fpplab.simulation.matchable import Twin, TwinParameters

PIXELS = 8_000
"""Pixels of the board that are used in each pose, about."""
LEAST_IMAGES = 7
"""Images of a set that tell flicker from motion."""
LEAST_GAIN = 3e-4
"""Standard deviation of the projector's light below which it is not told from faults of the fit."""
LEAST_BANDS = 2e-3
"""Amplitude of bands, relative to the level, below which they are not told from what motion leaves."""
LEAST_PERIOD_PX = 6.0
"""Least period of bands, in rows of the image."""
PERIODS_PER_HEIGHT = 4
"""Steps of the search along the axis of frequency for one period more over the board's height."""
NEARBY = 12
"""Frequencies, in periods over the board's height, whose power tells that of all that is no wave."""


@dataclass(frozen=True, eq=False)
class FrameChanges:
    """What changes from frame to frame in one fringe set of one pose.

    Attributes
    ----------
    gain_square : float
        Mean square of ε_n.
    gain_noise : float
        The same by noise alone.
    gain_freedom : float
        Number of independent ε_n that the set tells.
    rest : ndarray of float64
        Levels (N, P) that flicker, motion, offset and fringes leave, in 8-bit grey levels.
    freedom : int
        Number of independent frames of `rest`.
    level : ndarray of float64
        Mean levels A (P,) above black.
    rows : ndarray of float64
        Rows (P,) of the image.
    shows_bands : bool
        Whether fringes lie across the rows; otherwise what is left of a motion looks like bands.
    """

    gain_square: float
    gain_noise: float
    gain_freedom: float
    rest: Floats
    freedom: int
    level: Floats
    rows: Floats
    shows_bands: bool

    def wave_power(self, frequency: Floats) -> Floats:
        """Compute the mean squared amplitude of waves along the rows.

        Parameters
        ----------
        frequency : ndarray of float64
            (F,) in periods per row.

        Returns
        -------
        ndarray of float64
            (F,), of the mean frame; a quarter of ρ² for a wave of that frequency.
        """
        waves = self.level[:, None] * np.exp(-2j * np.pi * self.rows[:, None] * frequency)
        amplitudes = self.rest @ waves / (self.level @ self.level)
        return np.asarray(np.sum(np.abs(amplitudes) ** 2, axis=0) / self.freedom)


def frame_changes(
    reference: Reference, parameters: TwinParameters, poses: Sequence[int]
) -> list[FrameChanges]:
    """Find what changes from frame to frame on the bench.

    Parameters
    ----------
    reference : Reference
        What was recorded of the bench.
    parameters : TwinParameters
        Their poses tell where the board is; black level.
    poses : sequence of int
        Indices of the poses.

    Returns
    -------
    list of FrameChanges
        One for each pose and fringe set that tells flicker; empty where there is none.
    """
    return [one for pose in poses for one in _of_pose(reference, parameters, pose)]


def _of_pose(reference: Reference, parameters: TwinParameters, pose: int) -> Iterator[FrameChanges]:
    area = board_mask(parameters.calibration.camera, parameters.poses[pose], reference.target)
    pixels, grey = subsample_pixels(area, PIXELS), raw_per_grey(reference.settings.bits)
    plan, black = reference.plan, 255.0 * parameters.black_level
    for index, fringe in enumerate(plan.fringes):
        if fringe.images < LEAST_IMAGES:
            continue
        images = range(plan.set_starts[index], plan.set_starts[index + 1])
        frames = reference.frames(pose, images)
        slopes = np.stack([one[pixels] for one in np.gradient(frames.mean(axis=0))]) / grey
        levels = frames[:, *pixels].astype(np.float64)
        clear = levels.max(axis=0) < reference.full_scale
        yield changes_of_set(
            levels[:, clear] / grey - black, slopes[:, clear], (pixels[0][clear], pixels[1][clear]), fringe
        )


def changes_of_set(levels: Floats, slopes: Floats, pixels: PixelIndices, fringe: FringeSet) -> FrameChanges:
    """Fit flicker beside motion of each frame of a set.

    Motion shifts fringes and print, each its own way, and is no flicker: only what of the gains no motion can
    explain is counted.

    Parameters
    ----------
    levels : ndarray of float64
        (N, P) above black, in 8-bit grey levels.
    slopes : ndarray of float64
        (2, P) derivatives of the mean image along its axes, in grey levels per pixel.
    pixels : PixelIndices
        Rows and columns (P,) of the image.
    fringe : FringeSet
        With N images.

    Returns
    -------
    FrameChanges
        Of this set.
    """
    shift, count = fringe.phase_shifts(), len(levels)
    offset, cosine, sine = fit_sinusoids(levels, fringe)
    waves = np.stack([np.ones_like(shift), np.cos(shift), np.sin(shift)], axis=1)
    beyond = np.eye(count) - waves @ np.linalg.pinv(waves)
    light = offset + np.outer(np.cos(shift), cosine) + np.outer(np.sin(shift), sine)
    across = np.outer(np.sin(shift), cosine) - np.outer(np.cos(shift), sine)
    print_moves = [light * one / np.maximum(offset, 1.0) for one in slopes]
    size = np.sqrt(np.mean(light**2))
    tilts = [across * (one - one.mean()) for one in pixels]
    moves = (
        size / max(float(np.sqrt(np.mean(one**2))), 1e-9) * one for one in (across, *tilts, *print_moves)
    )
    regressors = [light, *moves]
    # Frame n has its own coefficients; what of them fits the pixel's own fringe is not seen.
    normal = np.block([[beyond * (a @ b.T) for b in regressors] for a in regressors])
    rest = beyond @ levels
    right = np.concatenate([np.sum(a * rest, axis=1) for a in regressors])
    for_all = _inverse(normal) @ right
    for n, regressor in enumerate(regressors):
        rest = rest - beyond @ (for_all[n * count : (n + 1) * count, None] * regressor)
    gain, motion = slice(count), slice(count, None)
    of_motion = normal[gain, motion] @ _inverse(normal[motion, motion])
    alone = normal[gain, gain] - of_motion @ normal[motion, gain]
    inverse = _inverse(alone)
    gains = inverse @ (right[gain] - of_motion @ right[motion])
    told = max(float(np.trace(inverse @ alone)), 1.0)
    freedom = count - 3
    noise = float(np.sum(rest**2)) / (freedom * rest.shape[1])
    return FrameChanges(
        float(gains @ gains) / told,
        noise * float(np.trace(inverse)) / told + LEAST_GAIN**2,
        told,
        rest,
        freedom,
        offset,
        pixels[0].astype(np.float64),
        fringe.axis == "x",
    )


def _inverse(normal: Floats) -> Floats:
    """Pseudo-inverse of a symmetric matrix, without directions that are not told."""
    strength, vectors = np.linalg.eigh(normal)
    told = strength > 1e-4 * max(strength[-1], 1e-12)
    return np.asarray((vectors[:, told] / strength[told]) @ vectors[:, told].T)


@dataclass(frozen=True, eq=False)
class Variances:
    """Random numbers of known noise whose further variance is asked for.

    Attributes
    ----------
    squares : ndarray of float64
        (K,) squared values, or squared sizes of complex ones.
    noise : ndarray of float64
        (K,) their expectation by noise alone.
    weight : ndarray of float64
        (K,) degrees of freedom of each.
    """

    squares: Floats
    noise: Floats
    weight: Floats

    def misfit(self, further: float) -> float:
        """Compute twice the negative logarithm of the likelihood of a further variance.

        Parameters
        ----------
        further : float
            The variance.

        Returns
        -------
        float
            But for a constant.
        """
        whole = self.noise + further
        return float(np.sum(self.weight * (np.log(whole) + self.squares / whole)))

    @cached_property
    def further(self) -> float:
        """The most likely further variance, not negative."""
        most = float(self.squares.max())
        if self.misfit(0.0) <= self.misfit(1e-6 * most):
            return 0.0
        found = minimize_scalar(
            lambda logarithm: self.misfit(float(np.exp(logarithm))),
            bounds=(np.log(1e-6 * most), np.log(most)),
            method="bounded",
        )
        return float(np.exp(found.x))

    @property
    def relative_sigma(self) -> float:
        """Standard uncertainty of the further standard deviation, relative."""
        share = self.further / (self.noise + self.further)
        return float(1.0 / np.sqrt(2.0 * max(np.sum(self.weight * share**2), 1e-12)))

    def criterion(self, further: float, free: int) -> float:
        """Compute Schwarz's criterion of a further variance.

        Parameters
        ----------
        further : float
            The variance.
        free : int
            Number of parameters that it takes.

        Returns
        -------
        float
            The least is the best.
        """
        return self.misfit(further) + free * float(np.log(np.sum(self.weight)))


def flicker_of(changes: Sequence[FrameChanges]) -> Variances:
    """Collect what tells the flicker.

    Parameters
    ----------
    changes : sequence of FrameChanges
        At least one.

    Returns
    -------
    Variances
        Its further variance is the square of the flicker.
    """
    found = np.array([[one.gain_square, one.gain_noise, one.gain_freedom] for one in changes])
    return Variances(*found.T)


def match_flicker(reference: Reference, now: TwinParameters, poses: Sequence[int]) -> TwinParameters:
    """Give a twin the flicker of the bench's projector.

    Parameters
    ----------
    reference : Reference
        What was recorded of the bench.
    now : TwinParameters
        Of the twin; not changed.
    poses : sequence of int
        Indices of the poses whose frames are used.

    Returns
    -------
    TwinParameters
        With flicker and its standard uncertainty; the same where no set tells it.
    """
    changes = frame_changes(reference, now, poses)
    if not changes:
        return now
    told = flicker_of(changes)
    flicker = float(np.sqrt(told.further))
    sigma = {"projector_flicker": flicker * told.relative_sigma} if flicker else {}
    return replace(now, projector_flicker=flicker, sigma={**now.sigma, **sigma})


def flicker_misfit(reference: Reference, now: TwinParameters, poses: Sequence[int]) -> float:
    """Judge the flicker of a twin by Schwarz's criterion.

    Parameters
    ----------
    reference : Reference
        What was recorded of the bench.
    now : TwinParameters
        Of the twin.
    poses : sequence of int
        Indices of the poses whose frames are used.

    Returns
    -------
    float
        The least is the best; 0 where no set tells flicker.
    """
    changes = frame_changes(reference, now, poses)
    if not changes:
        return 0.0
    return flicker_of(changes).criterion(now.projector_flicker**2, int(now.projector_flicker > 0))


@dataclass(frozen=True, eq=False)
class Bands:
    """Power of waves along the rows of many frames.

    Attributes
    ----------
    frequency : ndarray of float64
        (F,) in periods per row of the image.
    power : ndarray of float64
        (V, F) mean squared amplitude of V sets of frames, relative to the level.
    freedom : ndarray of float64
        (V,) independent frames of each set.
    height : float
        Rows that the board extends over.
    """

    frequency: Floats
    power: Floats
    freedom: Floats
    height: float

    @classmethod
    def of(cls, changes: Sequence[FrameChanges]) -> Bands | None:
        """Compute the power of waves from `LEAST_PERIOD_PX` to the board's height.

        Parameters
        ----------
        changes : sequence of FrameChanges
            Of a bench.

        Returns
        -------
        Bands or None
            None where no set shows bands.
        """
        shown = [one for one in changes if one.shows_bands]
        if not shown:
            return None
        height = max(float(np.ptp(one.rows)) for one in shown)
        steps = max(2, int(PERIODS_PER_HEIGHT * height / LEAST_PERIOD_PX))
        frequency = np.linspace(1.0 / height, 1.0 / LEAST_PERIOD_PX, steps)
        power = np.array([one.wave_power(frequency) for one in shown])
        return cls(frequency, power, np.array([float(one.freedom) for one in shown]), height)

    @cached_property
    def floor(self) -> Floats:
        """Power (V, F) by all that is no wave: the median over the frequencies nearby."""
        nearby = median_filter(self.power, (1, NEARBY * PERIODS_PER_HEIGHT), mode="nearest")
        return np.asarray(nearby + (0.5 * LEAST_BANDS) ** 2)

    @cached_property
    def best(self) -> int:
        """Index of the frequency with the greatest power."""
        return int(np.argmax(self.freedom @ (self.power / self.floor)))

    @property
    def best_frequency(self) -> float:
        """Place of the greatest power, by a parabola through the logarithms of three neighbours."""
        k, step = self.best, float(self.frequency[1] - self.frequency[0])
        if not 0 < k < len(self.frequency) - 1:
            return float(self.frequency[k])
        before, here, after = np.log(self.freedom @ self.power[:, k - 1 : k + 2])
        return float(self.frequency[k] + 0.5 * step * (before - after) / (before - 2 * here + after))

    def at(self, frequency: float) -> Variances:
        """Give the power at a frequency.

        Parameters
        ----------
        frequency : float
            In periods per row; the nearest that is known is taken.

        Returns
        -------
        Variances
            Its further variance is a quarter of ρ².
        """
        index = int(np.argmin(np.abs(self.frequency - frequency)))
        return Variances(self.power[:, index], self.floor[:, index], 2.0 * self.freedom)

    @property
    def period_sigma(self) -> float:
        """Standard uncertainty of the best period, relative: that of a wave's frequency in noise."""
        power, floor = self.power[:, self.best], self.floor[:, self.best]
        snr = float(np.sum(self.freedom * np.maximum(power / floor - 1.0, 0.0)))
        of_frequency = np.sqrt(6.0 / max(snr, 1e-9)) / (2.0 * np.pi * self.height)
        return float(of_frequency / self.frequency[self.best])


def match_bands(reference: Reference, twin: Twin, poses: Sequence[int]) -> TwinParameters:
    """Give a twin the rolling bands of the bench's ambient light. The twin is left as it is.

    Parameters
    ----------
    reference : Reference
        What was recorded of the bench.
    twin : Twin
        With matched ambient light, of which the bands are a share.
    poses : sequence of int
        Indices of the poses whose frames are used.

    Returns
    -------
    TwinParameters
        With ripple and period and their standard uncertainties; the same where nothing tells them.
    """
    now = twin.parameters
    bands = Bands.of(frame_changes(reference, now, poses))
    share = _ambient_share(reference, twin, poses)
    if bands is None or share <= 0:
        return now
    told = bands.at(bands.best_frequency)
    if not told.further:
        return now
    ripple = min(2.0 * float(np.sqrt(told.further)) / share, 1.0)
    period = 1.0 / bands.best_frequency
    sigma = {
        "ambient_ripple": ripple * told.relative_sigma,
        "band_period_px": period * bands.period_sigma,
    }
    return replace(now, ambient_ripple=ripple, band_period_px=period, sigma={**now.sigma, **sigma})


def bands_misfit(reference: Reference, twin: Twin, poses: Sequence[int]) -> float:
    """Judge the bands of a twin by Schwarz's criterion. The twin is left as it is.

    Parameters
    ----------
    reference : Reference
        What was recorded of the bench.
    twin : Twin
        With the parameters to judge.
    poses : sequence of int
        Indices of the poses whose frames are used.

    Returns
    -------
    float
        The least is the best; 0 where nothing tells bands.
    """
    now = twin.parameters
    bands = Bands.of(frame_changes(reference, now, poses))
    if bands is None:
        return 0.0
    if not now.ambient_ripple:
        return bands.at(bands.best_frequency).criterion(0.0, 0)
    half = 0.5 * now.ambient_ripple * _ambient_share(reference, twin, poses)
    return bands.at(1.0 / now.band_period_px).criterion(half**2, 2)


def _ambient_share(reference: Reference, twin: Twin, poses: Sequence[int]) -> float:
    """Share of the ambient light in the mean level of the board above black."""
    now, images = twin.parameters, reference.one_of_each_set
    shares = []
    for pose in poses:
        area = board_mask(now.calibration.camera, now.poses[pose], reference.target)
        pixels = subsample_pixels(area, PIXELS)

        def level(parameters: TwinParameters, pose: int = pose, pixels: PixelIndices = pixels) -> float:
            twin.become(parameters)
            seen = twin.expected_at(pose, reference.shown(images), reference.settings, pixels)
            return float(seen.mean()) - now.black_level * reference.full_scale

        shares.append(1.0 - level(replace(now, ambient=0.0)) / max(level(now), 1e-6))
    twin.become(now)
    return float(np.mean(shares))
