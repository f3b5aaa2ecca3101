"""Light of the room that ripples with the mains, as the bench's frames show it.

Under a rolling shutter it makes bands along the rows, under a global one it is another light in every frame.
Frames at regular intervals see it advance by the same share of a period from frame to frame. In step with the
fringes' phase steps it shifts the phase as much as that of the projector would, and no frame shows it; so the
advance is estimated, too, wherever frames agree on one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby

import numpy as np
from scipy.ndimage import median_filter

from fpplab.core.conventions import Floats
from sim.effects.step import Ripple
from sim.matching.fluctuation.frame_series import fit_along_rows, fit_fluctuation
from sim.matching.fluctuation.frame_terms import ROOM, ROOM_ROWS, FrameTerms
from sim.matching.fluctuation.fringe_residuals import Complex, FringeResidual, Variances


@dataclass(frozen=True)
class BandLimits:
    """What counts as bands in the rows of frames."""

    min_amplitude: float = 2e-3  # relative to the level; less is not distinguished from motion (chosen)
    min_period_px: float = 6.0  # in rows of the image (chosen)
    steps_per_period: int = 4  # steps of the search for one period more over the board (chosen)
    nearby: int = 12  # periods over the board whose power is that of all that is no wave (chosen)
    advance_step: float = 2e-3  # periods; step of the search for the advance from frame to frame (chosen)
    min_explained: float = 0.5  # share of the power that one advance must explain (chosen)
    in_step_period_px: float = 1e5  # of bands that are in step in all rows: far more than a sensor has


LIMITS = BandLimits()


@dataclass(frozen=True, eq=False)
class Bands:
    """Power of waves along the rows of many frames."""

    rests: tuple[FringeResidual, ...]  # V sets of frames that show bands
    frequency: Floats  # (F,) in periods per row of the image
    power: Floats  # (V, F) mean squared amplitude of each set, relative to the level
    freedom: Floats  # (V,) independent frames of each set
    height: float  # rows that the board extends over

    @classmethod
    def of(cls, rests: Sequence[FringeResidual]) -> Bands | None:
        """Compute the power of waves from `min_period_px` to the board's height."""
        shown = tuple(rest for rest in rests if rest.shows_bands)
        if not shown:
            return None
        height = max(float(np.ptp(rest.rows)) for rest in shown)
        steps = max(2, int(LIMITS.steps_per_period * height / LIMITS.min_period_px))
        frequency = np.linspace(1.0 / height, 1.0 / LIMITS.min_period_px, steps)
        power = np.array(
            [np.sum(np.abs(rest.waves(frequency)) ** 2, axis=0) / rest.freedom for rest in shown]
        )
        return cls(shown, frequency, power, np.array([float(rest.freedom) for rest in shown]), height)

    @cached_property
    def floor(self) -> Floats:
        """Power (V, F) by all that is no wave: the median over the frequencies nearby."""
        nearby = median_filter(self.power, (1, LIMITS.nearby * LIMITS.steps_per_period), mode="nearest")
        return np.asarray(nearby + (0.5 * LIMITS.min_amplitude) ** 2)

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
        index = int(np.argmin(np.abs(self.frequency - frequency)))
        return Variances(self.power[:, index], self.floor[:, index], 2.0 * self.freedom)

    @property
    def period_sigma(self) -> float:
        """Standard uncertainty of the best period, relative: that of a wave's frequency in noise."""
        power, floor = self.power[:, self.best], self.floor[:, self.best]
        snr = float(np.sum(self.freedom * np.maximum(power / floor - 1.0, 0.0)))
        of_frequency = np.sqrt(6.0 / max(snr, 1e-9)) / (2.0 * np.pi * self.height)
        return float(of_frequency / self.frequency[self.best])

    def advancing(self, frequency: float, advance: float) -> Variances:
        """Give the power at a frequency of waves that advance by the same from frame to frame."""
        index = int(np.argmin(np.abs(self.frequency - frequency)))
        squares, noise = [], []
        for _, group in groupby(range(len(self.rests)), lambda n: self.rests[n].pose):
            sets = list(group)
            amplitude, strength = _one_wave([self._waves(n, frequency) for n in sets], advance)
            squares.append(abs(amplitude) ** 2)
            noise.append(float(self.floor[sets, index].mean()) / strength)
        return Variances(np.array(squares), np.array(noise), np.full(len(squares), 2.0))

    def rolling(self, room_share: float) -> Ripple:
        """Take the strongest waves along the rows, with the advance that frames agree on, if there is one."""
        frequency = self.best_frequency
        power, free = self.at(frequency), 2
        advance, share = self._best_advance(frequency)
        if share >= LIMITS.min_explained:
            power, free = self.advancing(frequency, advance), 3
        return Ripple(
            2.0 * float(np.sqrt(power.further)) / room_share,
            power.relative_sigma,
            1.0 / frequency,
            self.period_sigma,
            advance if share >= LIMITS.min_explained else None,
            power.criterion(0.0, 0) - power.criterion(power.further, free),
        )

    def _waves(self, index: int, frequency: float) -> tuple[FringeResidual, Complex]:
        return self.rests[index], self.rests[index].waves(np.array([frequency]))[:, 0]

    def _best_advance(self, frequency: float) -> tuple[float, float]:
        """The advance with which waves explain most, and the share of all power that they explain."""
        tried = np.arange(-0.5, 0.5, LIMITS.advance_step)
        explained, whole = np.zeros(len(tried)), 0.0
        for _, group in groupby(range(len(self.rests)), lambda n: self.rests[n].pose):
            waves = [self._waves(n, frequency) for n in group]
            for n, advance in enumerate(tried.tolist()):
                amplitude, strength = _one_wave(waves, advance)
                explained[n] += strength * abs(amplitude) ** 2
            whole += sum(float(np.sum(np.abs(measured) ** 2)) for _, measured in waves)
        best = int(np.argmax(explained))
        return float(tried[best]), float(explained[best]) / max(whole, 1e-30)


def _one_wave(sets: Sequence[tuple[FringeResidual, Complex]], advance: float) -> tuple[complex, float]:
    """Fit one wave to the sets of a pose; its complex amplitude, and how many frames determine it."""
    # sets: with the waves (N,) of their frames.
    right, strength = 0j, 0.0
    for residual, waves in sets:
        expected = residual.beyond @ np.exp(2j * np.pi * advance * residual.frames)
        right += complex(np.vdot(expected, waves))
        strength += float(np.vdot(expected, expected).real)
    return right / max(strength, 1e-9), max(strength, 1e-9)


def ripple_in_step(terms: Sequence[FrameTerms]) -> Ripple:
    """Take light of the room that changes from frame to frame, equally in all rows or with a slow wave."""
    by_source = [list(terms), *map(list, zip(*(pose.of_sources for pose in terms), strict=False))]
    fits = [(fit_fluctuation([pose.series(ROOM) for pose in source]), source) for source in by_source]
    fluctuation, poses = max(fits, key=lambda fit: fit[0].gained)
    period_px, source = LIMITS.in_step_period_px, poses[0].source
    if not fluctuation.oscillation.any():
        amplitude = float(np.sqrt(2.0)) * fluctuation.random.isotropic
        return Ripple(amplitude, fluctuation.sigma, period_px, 0.0, None, fluctuation.gained, source)
    sign, period_sigma = 1.0, 0.0
    along_rows = fit_along_rows([pose.series(ROOM_ROWS) for pose in poses], fluctuation)
    if along_rows.fluctuation.gained > fluctuation.gained:
        fluctuation, turn = along_rows.fluctuation, along_rows.turn_per_px
        period_px, sign = min(2.0 * np.pi / abs(turn), period_px), float(np.sign(turn))
        period_sigma = along_rows.turn_sigma / abs(turn)
    amplitude = float(np.sqrt(2.0)) * abs(float(fluctuation.oscillation[0]))
    advance, gained = sign * fluctuation.cycles_per_frame, fluctuation.gained
    return Ripple(amplitude, fluctuation.sigma, period_px, period_sigma, advance, gained, source)


def strongest_ripple(terms: Sequence[FrameTerms], rests: Sequence[FringeResidual]) -> Ripple | None:
    """Find the rippling light of the bench's room: bands along the rows, or light that is in step."""
    share = float(np.mean([pose.room_share for pose in terms]))
    if share <= 0:
        return None
    bands = Bands.of(rests)
    candidates = [ripple_in_step(terms), *([bands.rolling(share)] if bands else [])]
    ripple = max(candidates, key=lambda ripple: ripple.gained)
    return ripple if ripple.gained > 0 and ripple.amplitude else None
