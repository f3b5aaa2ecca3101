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

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize, minimize_scalar

from fpplab.core.conventions import Floats


@dataclass(frozen=True)
class SeriesLimits:
    """How changes are searched in series of frames."""

    min_frames: int = 8  # of a pose, for a search of its frequency (chosen)
    steps_per_cycle: int = 6  # of the search, for one cycle more in the frames of a pose (chosen)
    rounds: int = 3  # estimates of what the oscillation leaves, which is the noise of the next one (chosen)
    min_isotropic_share: float = 0.02  # of what all directions have, relative to the axis; less is 0 (chosen)
    min_share: float = 1e-6  # least standard deviation, relative to the greatest value (numerical)


LIMITS = SeriesLimits()


@dataclass(frozen=True, eq=False)
class RandomDisplacement:
    """Random displacements of every frame, independent from frame to frame."""

    isotropic: float  # standard deviation of the part that is equally large in all directions
    axis: Floats  # standard deviation (k,) along an axis, with signs that give its direction

    @property
    def covariance(self) -> Floats:
        """(k, k)."""
        return np.asarray(self.isotropic**2 * np.eye(len(self.axis)) + np.outer(self.axis, self.axis))

    @property
    def free(self) -> int:
        """Number of parameters."""
        return int(self.isotropic > 0) + len(self.axis) * int(self.axis.any())


@dataclass(frozen=True, eq=False)
class Series:
    """What was estimated of every frame of a pose."""

    frames: Floats  # numbers (n,) of the frames in the session
    sets: NDArray[np.int64]  # fringe set (n,) of each
    values: Floats  # (n, k)
    covariance: Floats  # (n, k, k) by noise

    @property
    def freedom(self) -> int:
        """Number of independent frames once the means of their sets are taken off."""
        return len(self.frames) - len(np.unique(self.sets))

    def along(self, direction: Floats, isotropic: float) -> Series:
        """Estimate the values along a direction, which is all that there is but for random numbers."""
        # direction (k,)
        inverse = np.linalg.inv(self.covariance + isotropic**2 * np.eye(len(direction)))
        variance = 1.0 / np.einsum("i,nij,j->n", direction, inverse, direction)
        values = variance * np.einsum("i,nij,nj->n", direction, inverse, self.values)
        return Series(self.frames, self.sets, values[:, None], variance[:, None, None])

    def whitening(self, random: RandomDisplacement) -> Floats:
        """Give matrices (n, k, k) that make noise and random numbers have the variance 1."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance + random.covariance)))

    def centred(self, values: Floats, white: Floats) -> Floats:
        """Take off the weighted mean of every fringe set."""
        # values (n, k); white (n, k, k); returns (n, k)
        left = values.copy()
        weights = np.einsum("nki,nkj->nij", white, white)
        for one in np.unique(self.sets):
            of = self.sets == one
            total = np.einsum("nij,nj->i", weights[of], values[of])
            left[of] -= np.linalg.solve(weights[of].sum(axis=0), total)
        return left


@dataclass(frozen=True, eq=False)
class FrameFluctuation:
    """What changes in a series besides noise."""

    random: RandomDisplacement  # from frame to frame
    oscillation: Floats  # RMS value (k,) of the oscillation; 0 for none
    cycles_per_frame: float  # of the oscillation
    cycles_sigma: float  # standard uncertainty of that
    sigma: float  # standard uncertainty of the size of oscillation or random numbers, relative
    gained: float  # by how much Schwarz's criterion is lower than that of noise alone

    @property
    def size(self) -> float:
        """RMS value of all that changes, over all components together."""
        return float(np.sqrt(np.trace(self.random.covariance) + self.oscillation @ self.oscillation))


def fit_fluctuation(seen: Sequence[Series], oscillates: bool = True) -> FrameFluctuation:
    """Estimate what changes, as far as Schwarz's criterion asks for it."""
    size = seen[0].values.shape[1]
    best, still = RandomDisplacement(0.0, np.zeros(size)), _misfit_of_noise(seen)
    least = still
    for has_axis in (False, True)[: min(size, 2)]:
        random, left = _random_only(seen, has_axis)
        criterion = _criterion(seen, left, random, random.free)
        if criterion < least:
            best, least = random, criterion
    found = FrameFluctuation(best, np.zeros(size), 0.0, 0.0, _sigma(seen, best), still - least)
    enough = min(one.freedom for one in seen) >= LIMITS.min_frames
    if not oscillates or not enough or not (best.axis.any() or (size == 1 and best.free)):
        return found
    return _oscillating_along(seen, found) if size > 1 else _oscillating(seen, found)


def _oscillating(seen: Sequence[Series], found: FrameFluctuation) -> FrameFluctuation:
    oscillating = _with_oscillation(seen, found.random, _misfit_of_noise(seen))
    return oscillating if oscillating.gained > found.gained else found


def _oscillating_along(seen: Sequence[Series], found: FrameFluctuation) -> FrameFluctuation:
    """Look for an oscillation in what the series have along the line of the random numbers."""
    line = found.random.axis / np.linalg.norm(found.random.axis)
    along = [one.along(line, found.random.isotropic) for one in seen]
    alone = fit_fluctuation(along, oscillates=False)
    oscillating = _oscillating(along, alone)
    if not oscillating.oscillation.any():
        return found
    random = RandomDisplacement(found.random.isotropic, oscillating.random.isotropic * line)
    return replace(
        oscillating,
        random=random,
        oscillation=oscillating.oscillation[0] * line,
        gained=found.gained + oscillating.gained - alone.gained,
    )


def _misfit_of_noise(seen: Sequence[Series]) -> float:
    nothing = RandomDisplacement(0.0, np.zeros(seen[0].values.shape[1]))
    return _criterion(seen, _all_centred(seen, nothing), nothing, 0)


def _random_only(seen: Sequence[Series], has_axis: bool) -> tuple[RandomDisplacement, list[Floats]]:
    random = RandomDisplacement(0.0, np.zeros(seen[0].values.shape[1]))
    for _ in range(LIMITS.rounds):
        random = _most_likely(seen, _all_centred(seen, random), 0.0, has_axis)
    return random, _all_centred(seen, random)


def _all_centred(seen: Sequence[Series], random: RandomDisplacement) -> list[Floats]:
    return [one.centred(one.values, one.whitening(random)) for one in seen]


def _most_likely(
    seen: Sequence[Series], left: Sequence[Floats], taken: float, has_axis: bool
) -> RandomDisplacement:
    """The most likely random numbers, by what else is left (n, k) of each pose.

    taken: parameters that were fitted to each component of each pose, besides the means.
    """
    size = seen[0].values.shape[1]
    grown = [
        values * np.sqrt(len(values) / max(one.freedom - taken, 1.0))
        for one, values in zip(seen, left, strict=True)
    ]
    most = max(float(np.abs(one).max()) for one in grown)
    if not most:
        return RandomDisplacement(0.0, np.zeros(size))

    def of(unknown: Floats) -> RandomDisplacement:
        axis = most * unknown[1:] if has_axis else np.zeros(size)
        return RandomDisplacement(most * float(np.exp(unknown[0])), axis)

    bounds = (np.log(LIMITS.min_share), 0.0)
    isotropic = minimize_scalar(
        lambda x: _misfit(seen, grown, of(np.append(x, np.zeros(size)))), bounds=bounds
    )
    start = np.array([isotropic.x])
    if has_axis:
        weights = [1.0 / np.trace(one.covariance, axis1=1, axis2=2) for one in seen]
        scatter = sum(
            np.einsum("n,ni,nj->ij", w, values, values) - np.einsum("n,nij->ij", w, one.covariance)
            for one, values, w in zip(seen, grown, weights, strict=True)
        ) / sum(w.sum() for w in weights)
        strength, directions = np.linalg.eigh(scatter)
        line = np.sqrt(max(strength[-1], 1e-4 * most**2)) / most * directions[:, -1]
        start = np.append(start + np.log(0.5), line)
        limits = [bounds, *[(-1.0, 1.0)] * size]
        start = minimize(lambda unknown: _misfit(seen, grown, of(unknown)), start, bounds=limits).x
    random = of(start)
    least = max(10 * LIMITS.min_share * most, LIMITS.min_isotropic_share * float(np.linalg.norm(random.axis)))
    return replace(random, isotropic=0.0) if random.isotropic < least else random


def _sigma(seen: Sequence[Series], random: RandomDisplacement) -> float:
    """Relative standard uncertainty of the size of random numbers, by the frames that determine them."""
    information = 0.0
    for one in seen:
        noise = np.trace(one.covariance, axis1=1, axis2=2) + 1e-300
        information += one.freedom * float(
            np.mean((1.0 / (1.0 + noise / max(np.trace(random.covariance), 1e-300))) ** 2)
        )
    return float(1.0 / np.sqrt(2.0 * max(information, 1e-12)))


def _misfit(seen: Sequence[Series], left: Sequence[Floats], random: RandomDisplacement) -> float:
    """Twice the negative logarithm of the likelihood of what is left, but for a constant."""
    total = 0.0
    for one, values in zip(seen, left, strict=True):
        white = one.whitening(random)
        total += float(np.sum(np.einsum("nij,nj->ni", white, values) ** 2))
        total -= 2.0 * float(np.sum(np.log(np.diagonal(white, axis1=1, axis2=2))))
    return total


def _criterion(
    seen: Sequence[Series], left: Sequence[Floats], random: RandomDisplacement, free: int
) -> float:
    count = sum(values.size for values in left)
    return _misfit(seen, left, random) + free * float(np.log(count))


def _with_oscillation(seen: Sequence[Series], random: RandomDisplacement, still: float) -> FrameFluctuation:
    size, has_axis = seen[0].values.shape[1], bool(random.axis.any())
    unknown, left = _start(*_strongest(seen, random)), []
    for _ in range(LIMITS.rounds):
        whites = [one.whitening(random) for one in seen]
        found = least_squares(_whitened_residual, unknown, args=(seen, whites), x_scale="jac")
        unknown = found.x
        left = _residual(unknown, seen, whites)
        random = _most_likely(seen, left, (1 + size + len(seen)) / (size * len(seen)), has_axis)
    variance = np.linalg.pinv(found.jac.T @ found.jac)
    oscillation = unknown[1 : 1 + size]
    length = max(float(np.linalg.norm(oscillation)), 1e-300)
    of_size = float(np.sqrt(oscillation @ variance[1 : 1 + size, 1 : 1 + size] @ oscillation)) / length**2
    return FrameFluctuation(
        random,
        oscillation,
        float(np.clip(unknown[0], 1e-6, 0.5)),
        float(np.sqrt(variance[0, 0])),
        of_size,
        still - _criterion(seen, left, random, random.free + 1 + size + len(seen)),
    )


def _strongest(seen: Sequence[Series], random: RandomDisplacement) -> tuple[float, NDArray[np.complex128]]:
    """Find the frequency with which waves of any size in every pose explain most.

    Returns it, and there the amplitudes (poses, k) x of `Re(x exp(2 pi i f n))`.
    """
    span = max(float(np.ptp(one.frames)) for one in seen)
    tried = np.arange(LIMITS.steps_per_cycle, 0.5 * span * LIMITS.steps_per_cycle) / (
        span * LIMITS.steps_per_cycle
    )
    whites = [one.whitening(random) for one in seen]
    best, most = (0.0, np.zeros((len(seen), seen[0].values.shape[1]), complex)), -1.0
    for frequency in tried.tolist():
        explained, amplitudes = 0.0, []
        for one, white in zip(seen, whites, strict=True):
            gained, amplitude = _wave_of_pose(one, white, frequency)
            explained += gained
            amplitudes.append(amplitude)
        if explained > most:
            best, most = (frequency, np.array(amplitudes)), explained
    return best


def _wave_of_pose(one: Series, white: Floats, frequency: float) -> tuple[float, NDArray[np.complex128]]:
    """Fit means of the sets and a wave; by how much the wave lowers the misfit, and its amplitude (k,)."""
    turn, size = 2 * np.pi * frequency * one.frames, one.values.shape[1]
    means = (one.sets[:, None] == np.unique(one.sets)).astype(np.float64)
    wanted = np.einsum("nij,nj->ni", white, one.values).ravel()

    def fitted(basis: Floats) -> tuple[float, Floats]:
        matrix = np.einsum("nij,nk->nijk", white, basis)
        matrix = matrix.transpose(0, 1, 3, 2).reshape(len(turn) * size, -1)
        found = np.linalg.lstsq(matrix, wanted, rcond=1e-3)[0]
        return float(found @ (matrix.T @ wanted)), found.reshape(-1, size)

    without, _ = fitted(means)
    whole, found = fitted(np.column_stack([means, np.cos(turn), np.sin(turn)]))
    return whole - without, np.asarray(found[-2] - 1j * found[-1])


def _start(frequency: float, amplitudes: NDArray[np.complex128]) -> Floats:
    """Start of the fit: frequency, oscillation (k,) RMS, and the phase of every pose in rad."""
    directions = np.linalg.eigh(np.real(amplitudes.T @ amplitudes.conj()))[1]
    along = amplitudes @ directions[:, -1]
    oscillation = np.sqrt(0.5 * np.mean(np.abs(along) ** 2)) * directions[:, -1]
    return np.concatenate([[frequency], oscillation, np.angle(along) + 0.5 * np.pi])


def _residual(unknown: Floats, seen: Sequence[Series], whites: Sequence[Floats]) -> list[Floats]:
    """What an oscillation leaves of the values (n, k) of each pose, without the means of their sets."""
    size = seen[0].values.shape[1]
    frequency, oscillation, phases = unknown[0], unknown[1 : 1 + size], unknown[1 + size :]
    left = []
    for one, phase, white in zip(seen, phases, whites, strict=True):
        wave = np.sqrt(2.0) * np.sin(2 * np.pi * frequency * one.frames + phase)
        left.append(one.centred(one.values - np.outer(wave, oscillation), white))
    return left


def _whitened_residual(unknown: Floats, seen: Sequence[Series], whites: Sequence[Floats]) -> Floats:
    return np.concatenate(
        [
            np.einsum("nij,nj->ni", white, values).ravel()
            for white, values in zip(whites, _residual(unknown, seen, whites), strict=True)
        ]
    )
