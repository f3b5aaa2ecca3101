"""Fit of what changes from frame to frame, at random or with one frequency, to series of several poses.

Frame n of pose p has a mean of its fringe set, noise of known covariance, and

    e_n + v r_n + sqrt(2) w sin(2 pi f n + psi_p)

with random numbers e_n, equally large in all directions, others r_n along one axis v, and an oscillation w of
f cycles per frame, the same in all poses. Axis and oscillation are kept where Schwarz's criterion asks for
them. What moves along an axis oscillates along it: across the axis, faults of the twin that go in step with
the phase steps would be taken for an oscillation.

Light whose phase turns along the rows of the image is one oscillation of two components: of the light as a
whole, and of its gradient along the rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space, solve_triangular
from scipy.optimize import minimize, minimize_scalar

from fpplab.core.conventions import Floats
from sim.effects.step import FrameFluctuation, RandomDisplacement


@dataclass(frozen=True)
class SeriesLimits:
    """How changes are searched in series of frames."""

    min_frames: int = 8  # of a pose, for a search of its frequency (chosen)
    steps_per_cycle: int = 6  # of the search, for one cycle more in the frames of a pose (chosen)
    max_turns: int = 1  # of a wave over the rows of the light; more are looked for as bands (chosen)
    row_bins: int = 64  # of a profile along the rows: a wave turns little within one (chosen)
    phases_per_width: float = 8.0  # places at which likelihoods of a phase are added up, by their width
    min_isotropic_share: float = 0.02  # of what all directions have, relative to the axis; less is 0 (chosen)
    min_share: float = 1e-6  # minimum standard deviation, relative to the greatest value (numerical)


LIMITS = SeriesLimits()


@dataclass(frozen=True, eq=False)
class RowProfile:
    """Over which rows of the image the light extends whose changes are estimated."""

    rows: Floats  # middles (B,) of bins
    weights: Floats  # (B,) of the bins in the estimate

    @classmethod
    def of(cls, rows: NDArray[np.intp], light: Floats) -> RowProfile:
        # rows, light (P,)
        weights, edges = np.histogram(rows, LIMITS.row_bins, weights=light.astype(np.float64) ** 2)
        return cls(0.5 * (edges[1:] + edges[:-1]), weights)

    def gradient(self, rows: Floats | NDArray[np.intp]) -> Floats:
        """Places from -1 to 1, that of the first and of the last row."""
        first, last = self.rows[[0, -1]]
        return np.asarray((2.0 * rows - first - last) / (last - first))

    def of_wave(self, turn_per_px: float) -> NDArray[np.complex128]:
        """Give the level and the gradient (2,) that a wave along the rows is taken for."""
        columns = np.column_stack([np.ones_like(self.rows), self.gradient(self.rows)])
        root = np.sqrt(self.weights)
        wave = np.exp(1j * turn_per_px * (self.rows - self.rows.mean()))
        return np.asarray(np.linalg.lstsq(root[:, None] * columns, root * wave, rcond=None)[0])


@dataclass(frozen=True, eq=False)
class Series:
    """What was estimated of every frame of a pose."""

    frames: Floats  # numbers (n,) of the frames in the session
    sets: NDArray[np.int64]  # fringe set (n,) of each
    values: Floats  # (n, k)
    covariance: Floats  # (n k, n k) by noise, and by faults of the fit that frames of a set share
    profile: RowProfile | None = None  # of light with a gradient, which are the two components

    @cached_property
    def contrasts(self) -> Floats:
        """Orthonormal combinations (n, m) of frames that the means of their sets do not change."""
        members = (self.sets[:, None] == np.unique(self.sets)).astype(np.float64)
        return np.asarray(null_space(members.T))

    @property
    def freedom(self) -> int:
        """Number of independent frames once the means of their sets are taken off."""
        return self.contrasts.shape[1]

    def along(self, direction: Floats, isotropic: float) -> Series:
        """Estimate the values along a direction, which is all that there is but for random numbers."""
        # direction (k,)
        onto = np.kron(np.eye(len(self.frames)), direction[:, None])
        weights = np.linalg.solve(self.covariance + isotropic**2 * np.eye(self.values.size), onto)
        covariance = np.linalg.inv(onto.T @ weights)
        return Series(
            self.frames, self.sets, (covariance @ weights.T @ self.values.ravel())[:, None], covariance
        )

    @cached_property
    def contrasted(self) -> Floats:
        """The values (m, k) without the means of their fringe sets."""
        return np.asarray(self.contrasts.T @ self.values)

    @cached_property
    def contrasts_of_components(self) -> Floats:
        """The contrasts (n k, m k) of every component."""
        return np.kron(self.contrasts, np.eye(self.values.shape[1]))

    @cached_property
    def noise(self) -> Floats:
        """Covariance (m k, m k) of contrasts without any changes."""
        mixed = self.contrasts_of_components
        return np.asarray(mixed.T @ self.covariance @ mixed)

    @cached_property
    def independent(self) -> tuple[Floats, Floats]:
        """Variances (m k,) of independent contrasts, and these in columns (n k, m k)."""
        variances, basis = np.linalg.eigh(self.noise)
        return np.maximum(variances, 0.0), self.contrasts_of_components @ basis

    def waves(self, frequency: float, turn_per_px: float) -> Floats:
        """Give sine and cosine (n k, 2) of RMS size 1, of periods per frame and rad per row."""
        turns = np.exp(2j * np.pi * frequency * self.frames)
        of_rows = np.ones(1) if self.profile is None else self.profile.of_wave(turn_per_px)
        waves = np.sqrt(2.0) * np.outer(turns, of_rows).ravel()
        return np.column_stack([waves.imag, waves.real])

    @property
    def mean_noise(self) -> Floats:
        """Mean covariance (k, k) of a contrast."""
        size = self.values.shape[1]
        blocks = self.noise.reshape(self.freedom, size, self.freedom, size)
        return np.asarray(np.einsum("niNj,nN->ij", blocks, np.eye(self.freedom)) / self.freedom)

    def whitening(self, random: RandomDisplacement) -> Floats:
        """Give the matrix (m k, m k) that makes noise and random numbers in contrasts have the variance 1."""
        factor = np.linalg.cholesky(self.noise + self.changes(random))
        return np.asarray(solve_triangular(factor, np.eye(len(factor)), lower=True))

    def changes(self, random: RandomDisplacement) -> Floats:
        """Covariance (m k, m k) of contrasts by random numbers alone."""
        return np.asarray(np.kron(np.eye(self.freedom), random.covariance))


def fit_fluctuation(series: Sequence[Series], oscillates: bool = True) -> FrameFluctuation:
    """Estimate what changes, as far as Schwarz's criterion asks for it."""
    size = series[0].values.shape[1]
    series, best = [pose for pose in series if pose.freedom], RandomDisplacement(0.0, np.zeros(size))
    if not series:  # sets of one image show no changes
        return FrameFluctuation(best, np.zeros(size), 0.0, 0.0, 0.0, 0.0)
    still = _misfit_of_noise(series)
    lowest = still
    for has_axis in (False, True)[: min(size, 2)]:
        random = _most_likely(series, has_axis)
        criterion = _criterion(series, random)
        if criterion < lowest:
            best, lowest = random, criterion
    fluctuation = FrameFluctuation(
        best, np.zeros(size), 0.0, 0.0, _relative_sigma(series, best), still - lowest
    )
    enough = min(pose.freedom for pose in series) >= LIMITS.min_frames
    if not oscillates or not enough or not (best.axis.any() or (size == 1 and best.free)):
        return fluctuation
    return (
        _oscillating_along(series, fluctuation)
        if size > 1
        else _with_oscillation_if_likelier(series, fluctuation)
    )


def _with_oscillation_if_likelier(series: Sequence[Series], alone: FrameFluctuation) -> FrameFluctuation:
    oscillating = _with_oscillation(series, alone.random.isotropic, _misfit_of_noise(series))
    return oscillating if oscillating.gained > alone.gained else alone


def _oscillating_along(series: Sequence[Series], fluctuation: FrameFluctuation) -> FrameFluctuation:
    """Look for an oscillation in what the series have along the line of the random numbers."""
    line = fluctuation.random.axis / np.linalg.norm(fluctuation.random.axis)
    along = [pose.along(line, fluctuation.random.isotropic) for pose in series]
    alone = fit_fluctuation(along, oscillates=False)
    oscillating = _with_oscillation_if_likelier(along, alone)
    if not oscillating.oscillation.any():
        return fluctuation
    random = RandomDisplacement(fluctuation.random.isotropic, oscillating.random.isotropic * line)
    return replace(
        oscillating,
        random=random,
        oscillation=oscillating.oscillation[0] * line,
        gained=fluctuation.gained + oscillating.gained - alone.gained,
    )


def _misfit_of_noise(series: Sequence[Series]) -> float:
    nothing = RandomDisplacement(0.0, np.zeros(series[0].values.shape[1]))
    return _criterion(series, nothing)


def _most_likely(series: Sequence[Series], has_axis: bool) -> RandomDisplacement:
    size = series[0].values.shape[1]
    largest = max(float(np.abs(pose.contrasted).max()) for pose in series)
    if not largest:
        return RandomDisplacement(0.0, np.zeros(size))

    def of(unknown: Floats) -> RandomDisplacement:
        axis = largest * unknown[1:] if has_axis else np.zeros(size)
        return RandomDisplacement(largest * float(np.exp(unknown[0])), axis)

    bounds = (np.log(LIMITS.min_share), 0.0)
    isotropic = minimize_scalar(lambda x: _misfit(series, of(np.append(x, np.zeros(size)))), bounds=bounds)
    start = np.array([isotropic.x])
    if has_axis:
        weights = [1.0 / np.trace(pose.mean_noise) for pose in series]
        scatter = sum(
            w * (pose.contrasted.T @ pose.contrasted - pose.freedom * pose.mean_noise)
            for pose, w in zip(series, weights, strict=True)
        ) / sum(w * pose.freedom for pose, w in zip(series, weights, strict=True))
        strength, directions = np.linalg.eigh(scatter)
        line = np.sqrt(max(strength[-1], 1e-4 * largest**2)) / largest * directions[:, -1]
        start = np.append(start + np.log(0.5), line)
        limits = [bounds, *[(-1.0, 1.0)] * size]
        start = minimize(lambda unknown: _misfit(series, of(unknown)), start, bounds=limits).x
    random = of(start)
    min_isotropic = max(
        10 * LIMITS.min_share * largest, LIMITS.min_isotropic_share * float(np.linalg.norm(random.axis))
    )
    return replace(random, isotropic=0.0) if random.isotropic < min_isotropic else random


def _relative_sigma(series: Sequence[Series], random: RandomDisplacement) -> float:
    """Relative standard uncertainty of the size of random numbers, by the frames that determine them."""
    information = 0.0
    for pose in series:
        white = pose.whitening(random)
        information += float(np.sum((white @ pose.changes(random) @ white.T) ** 2))
    return float(1.0 / np.sqrt(2.0 * max(information, 1e-12)))


def _misfit(series: Sequence[Series], random: RandomDisplacement) -> float:
    """Twice the negative logarithm of the likelihood, but for a constant."""
    total = 0.0
    for pose in series:
        white = pose.whitening(random)
        total += float(np.sum((white @ pose.contrasted.ravel()) ** 2))
        total -= 2.0 * float(np.sum(np.log(np.diagonal(white))))
    return total


def _criterion(series: Sequence[Series], random: RandomDisplacement) -> float:
    return _misfit(series, random) + random.free * _cost_of_parameter(series)


def _cost_of_parameter(series: Sequence[Series]) -> float:
    return float(np.log(sum(pose.freedom * pose.values.shape[1] for pose in series)))


@dataclass(frozen=True, eq=False)
class _Waves:
    """Waves of one frequency in a pose's contrasts, whose noise is independent in this basis."""

    cross: Floats  # (2,) of sine and cosine with the contrasts, both over their variance
    square: Floats  # (2, 2) of sine and cosine with each other
    without: float  # misfit without a wave

    @classmethod
    def of(cls, pose: Series, frequency: float, random: float, turn_per_px: float = 0.0) -> _Waves:
        noise, contrasts = pose.independent
        variances = noise + random**2
        waves = contrasts.T @ pose.waves(frequency, turn_per_px)
        values = contrasts.T @ pose.values.ravel()
        without = float(np.sum(values**2 / variances + np.log(variances)))
        return cls(waves.T @ (values / variances), waves.T @ (waves / variances[:, None]), without)

    @property
    def amplitudes(self) -> Floats:
        """The most likely amplitudes (2,) of sine and cosine."""
        return np.asarray(np.linalg.pinv(self.square, rcond=1e-3, hermitian=True) @ self.cross)

    def misfit(self, rms: float) -> float:
        """Twice the negative logarithm of the likelihood of an RMS size, if any phase is as likely."""
        sharpness = rms * float(np.sqrt(np.trace(self.square)))
        count = int(LIMITS.phases_per_width * (2.0 * np.pi + sharpness))
        phase = 2.0 * np.pi * np.arange(count) / count
        unit = np.stack([np.cos(phase), np.sin(phase)])
        exponent = rms * self.cross @ unit - 0.5 * rms**2 * np.sum(unit * (self.square @ unit), axis=0)
        highest = exponent.max()  # SciPy's logsumexp takes five times as long for so few
        return self.without - 2.0 * float(highest + np.log(np.mean(np.exp(exponent - highest))))


def _with_oscillation(series: Sequence[Series], random: float, still: float) -> FrameFluctuation:
    """Fit an oscillation and random numbers to series of one component."""
    frequency, rms = _find_strongest_wave(series, random)
    fit = _fit_wave(series, np.array([frequency, np.log(rms), np.log(0.5 * (random or rms))]))
    gained = still - fit.misfit - len(fit.at) * _cost_of_parameter(series)
    return _fluctuation_of(fit, gained)


@dataclass(frozen=True, eq=False)
class RowOscillation:
    """An oscillation whose phase turns along the rows of the image."""

    fluctuation: FrameFluctuation
    turn_per_px: float  # rad; negative where the oscillation moves towards later rows
    turn_sigma: float  # standard uncertainty of that


def fit_along_rows(series: Sequence[Series], in_step: FrameFluctuation) -> RowOscillation:
    """Fit the turn along the rows of an oscillation that is known of the light as a whole."""
    size, random = abs(float(in_step.oscillation[0])), in_step.random.isotropic
    start = np.array([in_step.cycles_per_frame, np.log(size), np.log(random or LIMITS.min_share * size)])
    equal = _fit_wave(series, start)
    height = max(float(np.ptp(pose.profile.rows)) for pose in series if pose.profile)
    most = 2 * np.pi * LIMITS.max_turns / height
    tried = np.linspace(-most, most, 2 * LIMITS.max_turns * LIMITS.steps_per_cycle + 1)
    turn = min(tried.tolist(), key=lambda turn: _misfit_of_wave(series, np.append(equal.at, turn)))
    fit = _fit_wave(series, np.append(equal.at, turn), 0.1 * float(tried[1] - tried[0]))
    gained = in_step.gained + equal.misfit - fit.misfit - _cost_of_parameter(series)
    return RowOscillation(_fluctuation_of(fit, gained), float(fit.at[3]), float(fit.sigma[3]))


@dataclass(frozen=True, eq=False)
class _FittedWave:
    """Cycles per frame, logarithms of RMS size and random numbers, and where it is free the turn per row."""

    at: Floats  # (3,) or (4,)
    sigma: Floats  # standard uncertainties of them
    misfit: float


def _misfit_of_wave(series: Sequence[Series], unknown: Floats) -> float:
    (frequency, _, _, *turn), (rms, rest) = unknown.tolist(), np.exp(unknown[1:3]).tolist()
    if not 0.0 < frequency <= 0.5:
        return float("inf")
    return sum(_Waves.of(pose, frequency, rest, *turn).misfit(rms) for pose in series)


def _fit_wave(series: Sequence[Series], start: Floats, turn_step: float = 0.0) -> _FittedWave:
    misfit = partial(_misfit_of_wave, series)
    step = 0.1 / max(float(np.ptp(pose.frames)) for pose in series)
    count = len(start)
    steps = np.diag([step if start[0] < 0.25 else -step, 0.3, 0.5, turn_step][:count])
    options = {"initial_simplex": np.vstack([start, start + steps]), "xatol": 1e-5, "fatol": 1e-3}
    fit = minimize(misfit, start, method="Nelder-Mead", options=options)
    sigma = _standard_errors(misfit, fit.x, np.array([0.1 * step, 0.02, 0.02, 0.1 * turn_step][:count]))
    return _FittedWave(fit.x, sigma, float(fit.fun))


def _fluctuation_of(fit: _FittedWave, gained: float) -> FrameFluctuation:
    rms, rest = np.exp(fit.at[1:3]).tolist()
    alone, (frequency_sigma, relative_sigma, *_) = RandomDisplacement(rest, np.zeros(1)), fit.sigma.tolist()
    return FrameFluctuation(alone, np.array([rms]), float(fit.at[0]), frequency_sigma, relative_sigma, gained)


def _standard_errors(misfit: Callable[[Floats], float], at: Floats, steps: Floats) -> Floats:
    """Standard errors (k,) at the minimum of a misfit, by its second derivatives."""
    moves = np.diag(steps)
    at = np.append(min(at[0], 0.5 - 2 * steps[0]), at[1:])  # frequencies on both sides are below 0.5

    def curvature(a: Floats, b: Floats) -> float:
        corners = misfit(at + a + b) - misfit(at + a - b) - misfit(at - a + b) + misfit(at - a - b)
        return corners / 8.0

    strength, directions = np.linalg.eigh([[curvature(a, b) for b in moves] for a in moves])
    variances = directions**2 @ (1.0 / np.maximum(strength, 1e-6 * max(strength[-1], 1e-300)))
    return np.asarray(steps * np.sqrt(variances))


def _find_strongest_wave(series: Sequence[Series], random: float) -> tuple[float, float]:
    """Find the frequency with which waves of any size in every pose explain most, and their RMS size."""
    span = max(float(np.ptp(pose.frames)) for pose in series)
    tried = np.arange(LIMITS.steps_per_cycle, 0.5 * span * LIMITS.steps_per_cycle) / (
        span * LIMITS.steps_per_cycle
    )
    best, highest = (0.0, 0.0), -1.0
    for frequency in tried.tolist():
        waves = [_Waves.of(pose, frequency, random) for pose in series]
        explained = sum(float(wave.amplitudes @ wave.cross) for wave in waves)
        if explained > highest:
            sizes = np.linalg.norm([wave.amplitudes for wave in waves], axis=1)
            best, highest = (frequency, float(np.sqrt(np.mean(sizes**2)))), explained
    return best
