"""Fit of what changes from frame to frame, at random or with one frequency, to series of several poses.

Frame n of pose p has a mean of its fringe set, noise of known covariance, and

    e_n + v r_n + sqrt(2) w sin(2 pi f n + psi_p)

with random numbers e_n, equally large in all directions, others r_n along one axis v, and an oscillation w of
f cycles per frame, the same in all poses. Axis and oscillation are kept where Schwarz's criterion asks for
them. What moves along an axis oscillates along it: across the axis, faults of the twin that go in step with
the phase steps would be taken for an oscillation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space, solve_triangular
from scipy.optimize import least_squares, minimize, minimize_scalar

from fpplab.core.conventions import Floats
from sim.effects.step import FrameFluctuation, RandomDisplacement


@dataclass(frozen=True)
class SeriesLimits:
    """How changes are searched in series of frames."""

    min_frames: int = 8  # of a pose, for a search of its frequency (chosen)
    steps_per_cycle: int = 6  # of the search, for one cycle more in the frames of a pose (chosen)
    rounds: int = 3  # estimates of what the oscillation leaves, which is the noise of the next one (chosen)
    min_isotropic_share: float = 0.02  # of what all directions have, relative to the axis; less is 0 (chosen)
    min_share: float = 1e-6  # minimum standard deviation, relative to the greatest value (numerical)


LIMITS = SeriesLimits()


@dataclass(frozen=True, eq=False)
class Series:
    """What was estimated of every frame of a pose."""

    frames: Floats  # numbers (n,) of the frames in the session
    sets: NDArray[np.int64]  # fringe set (n,) of each
    values: Floats  # (n, k)
    covariance: Floats  # (n k, n k) by noise, and by faults of the fit that frames of a set share

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

    def contrasted(self, values: Floats) -> Floats:
        """Take off the means of the fringe sets."""
        # values (n, ...); returns (m, ...)
        return np.asarray(np.tensordot(self.contrasts.T, values, 1))

    @cached_property
    def noise(self) -> Floats:
        """Covariance (m k, m k) of contrasts without any changes."""
        mixed = np.kron(self.contrasts, np.eye(self.values.shape[1]))
        return np.asarray(mixed.T @ self.covariance @ mixed)

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
    best, still = RandomDisplacement(0.0, np.zeros(size)), _misfit_of_noise(series)
    lowest, contrasts = still, [pose.contrasted(pose.values) for pose in series]
    for has_axis in (False, True)[: min(size, 2)]:
        random = _most_likely(series, contrasts, 0.0, has_axis)
        criterion = _criterion(series, contrasts, random, random.free)
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
    oscillating = _with_oscillation(series, alone.random, _misfit_of_noise(series))
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
    return _criterion(series, [pose.contrasted(pose.values) for pose in series], nothing, 0)


def _most_likely(
    series: Sequence[Series], residuals: Sequence[Floats], taken: float, has_axis: bool
) -> RandomDisplacement:
    """The most likely random numbers, by what is left of the contrasts (m, k) of each pose."""
    # taken: parameters that were fitted to each component of each pose.
    size = series[0].values.shape[1]
    grown = [
        values * np.sqrt(pose.freedom / max(pose.freedom - taken, 1.0))
        for pose, values in zip(series, residuals, strict=True)
    ]
    largest = max(float(np.abs(pose).max()) for pose in grown)
    if not largest:
        return RandomDisplacement(0.0, np.zeros(size))

    def of(unknown: Floats) -> RandomDisplacement:
        axis = largest * unknown[1:] if has_axis else np.zeros(size)
        return RandomDisplacement(largest * float(np.exp(unknown[0])), axis)

    bounds = (np.log(LIMITS.min_share), 0.0)
    isotropic = minimize_scalar(
        lambda x: _misfit(series, grown, of(np.append(x, np.zeros(size)))), bounds=bounds
    )
    start = np.array([isotropic.x])
    if has_axis:
        weights = [1.0 / np.trace(pose.mean_noise) for pose in series]
        scatter = sum(
            w * (values.T @ values - pose.freedom * pose.mean_noise)
            for pose, values, w in zip(series, grown, weights, strict=True)
        ) / sum(w * pose.freedom for pose, w in zip(series, weights, strict=True))
        strength, directions = np.linalg.eigh(scatter)
        line = np.sqrt(max(strength[-1], 1e-4 * largest**2)) / largest * directions[:, -1]
        start = np.append(start + np.log(0.5), line)
        limits = [bounds, *[(-1.0, 1.0)] * size]
        start = minimize(lambda unknown: _misfit(series, grown, of(unknown)), start, bounds=limits).x
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


def _misfit(series: Sequence[Series], residuals: Sequence[Floats], random: RandomDisplacement) -> float:
    """Twice the negative logarithm of the likelihood of residuals (m, k), but for a constant."""
    total = 0.0
    for pose, values in zip(series, residuals, strict=True):
        white = pose.whitening(random)
        total += float(np.sum((white @ values.ravel()) ** 2))
        total -= 2.0 * float(np.sum(np.log(np.diagonal(white))))
    return total


def _criterion(
    series: Sequence[Series], residuals: Sequence[Floats], random: RandomDisplacement, free: int
) -> float:
    count = sum(values.size for values in residuals)
    return _misfit(series, residuals, random) + free * float(np.log(count))


def _with_oscillation(series: Sequence[Series], random: RandomDisplacement, still: float) -> FrameFluctuation:
    size, has_axis = series[0].values.shape[1], bool(random.axis.any())
    unknown, residuals = _start_of_fit(*_find_strongest_wave(series, random)), []
    for _ in range(LIMITS.rounds):
        whites = [pose.whitening(random) for pose in series]
        fit = least_squares(_whitened_residual, unknown, args=(series, whites), x_scale="jac")
        unknown = fit.x
        residuals = _residual(unknown, series)
        random = _most_likely(series, residuals, (1 + size + len(series)) / (size * len(series)), has_axis)
    variance = np.linalg.pinv(fit.jac.T @ fit.jac)
    oscillation = unknown[1 : 1 + size]
    length = max(float(np.linalg.norm(oscillation)), 1e-300)
    of_size = float(np.sqrt(oscillation @ variance[1 : 1 + size, 1 : 1 + size] @ oscillation)) / length**2
    return FrameFluctuation(
        random,
        oscillation,
        float(np.clip(unknown[0], 1e-6, 0.5)),
        float(np.sqrt(variance[0, 0])),
        of_size,
        still - _criterion(series, residuals, random, random.free + 1 + size + len(series)),
    )


def _find_strongest_wave(
    series: Sequence[Series], random: RandomDisplacement
) -> tuple[float, NDArray[np.complex128]]:
    """Find the frequency with which waves of any size in every pose explain most."""
    # Returns it, and there the amplitudes (poses, k) x of `Re(x exp(2 pi i f n))`.
    span = max(float(np.ptp(pose.frames)) for pose in series)
    tried = np.arange(LIMITS.steps_per_cycle, 0.5 * span * LIMITS.steps_per_cycle) / (
        span * LIMITS.steps_per_cycle
    )
    whites = [pose.whitening(random) for pose in series]
    best, highest = (0.0, np.zeros((len(series), series[0].values.shape[1]), complex)), -1.0
    for frequency in tried.tolist():
        explained, amplitudes = 0.0, []
        for pose, white in zip(series, whites, strict=True):
            gained, amplitude = _wave_of_pose(pose, white, frequency)
            explained += gained
            amplitudes.append(amplitude)
        if explained > highest:
            best, highest = (frequency, np.array(amplitudes)), explained
    return best


def _wave_of_pose(pose: Series, white: Floats, frequency: float) -> tuple[float, NDArray[np.complex128]]:
    """Fit a wave; by how much it lowers the misfit, and its amplitude (k,)."""
    turn, size = 2 * np.pi * frequency * pose.frames, pose.values.shape[1]
    wave = pose.contrasted(np.column_stack([np.cos(turn), np.sin(turn)]))
    matrix, values = white @ np.kron(wave, np.eye(size)), white @ pose.contrasted(pose.values).ravel()
    coefficients = np.linalg.lstsq(matrix, values, rcond=1e-3)[0]
    cosine, sine = coefficients.reshape(2, size)
    return float(coefficients @ (matrix.T @ values)), np.asarray(cosine - 1j * sine)


def _start_of_fit(frequency: float, amplitudes: NDArray[np.complex128]) -> Floats:
    """Start of the fit: frequency, oscillation (k,) RMS, and the phase of every pose in rad."""
    directions = np.linalg.eigh(np.real(amplitudes.T @ amplitudes.conj()))[1]
    along = amplitudes @ directions[:, -1]
    oscillation = np.sqrt(0.5 * np.mean(np.abs(along) ** 2)) * directions[:, -1]
    return np.concatenate([[frequency], oscillation, np.angle(along) + 0.5 * np.pi])


def _residual(unknown: Floats, series: Sequence[Series]) -> list[Floats]:
    """What an oscillation leaves of the contrasts (m, k) of each pose."""
    size = series[0].values.shape[1]
    frequency, oscillation, phases = unknown[0], unknown[1 : 1 + size], unknown[1 + size :]
    residuals = []
    for pose, phase in zip(series, phases, strict=True):
        wave = np.sqrt(2.0) * np.sin(2 * np.pi * frequency * pose.frames + phase)
        residuals.append(pose.contrasted(pose.values - np.outer(wave, oscillation)))
    return residuals


def _whitened_residual(unknown: Floats, series: Sequence[Series], whites: Sequence[Floats]) -> Floats:
    return np.concatenate(
        [white @ values.ravel() for white, values in zip(whites, _residual(unknown, series), strict=True)]
    )
