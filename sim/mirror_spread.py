"""How the light of one mirror spreads, and how it is interpolated from the nearest mirrors alone.

A mirror is an even square; the lens blurs it with a Gaussian point spread, and out of focus with the disc of
the circle of confusion besides. Mirror n then gives the light `h(x - n)` at a place x of the lattice, and a
blurred `h` reaches over many mirrors. The sum over all of them is therefore split into a filter `g` of the
mirrors' levels and an interpolation `p` between the `TAPS` nearest mirrors along each axis:

    sum_n h(x - n) level_n = sum_n p(x - n) filtered_n,    filtered = g * level

In terms of frequency, `H(f + k) = G(f) P(f + k)` for every whole k. The filter, periodic in f, can give
fringes of any period their modulation; but how strong the images of the fringes in the lattice are, k ≠ 0,
which show as the lattice's ripple in the phase, depends on `P(f + k) / P(f)` alone. So `p` is chosen for
these ratios to be those of `h` at the periods of fringes, by linear least squares over its values, and `g`
follows. (An interpolation of some standard kind, such as linear or cubic, has images of its own, whatever the
optics.)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf, j1

from fpplab.core.conventions import Floats

TAPS = 5
"""Mirrors along each axis between which light is interpolated (chosen): compiled into `sim.light.look_up`."""
STEPS = 64
"""Places between two mirrors at which the interpolation is tabulated (chosen); between them it is linear."""
BAND = 0.28
"""Highest frequency of fringes, in periods per mirror along an axis, at which images are exact (chosen)."""
WIDEST_BLUR, WIDEST_CIRCLE = 1.0, 1.5
"""Blur and circle of confusion, in mirrors, above which the filter alone widens the light further: images are
then weaker than 1e-4."""
MIN_BLUR = 0.25
"""Least blur in mirrors for which `TAPS` mirrors hold all light of a place; a sharper lens shows edges."""

_FREQUENCIES = np.arange(65) / 128  # frequencies at which the interpolation is fitted, in periods per mirror
_REST, _PULL = 1e-4, 1e-7
"""Weight of frequencies above `BAND`, and of the spread's own waves, which settles what is left open."""
_MIRRORS = np.arange(-12, 13)
"""Mirrors that give light to a place between two of them, for any spread that is interpolated."""


@dataclass(frozen=True)
class MirrorPointSpread:
    """What widens the light of a mirror, in units of the lattice."""

    blur: float  # standard deviation of the lens's point spread, at least `MIN_BLUR`
    fill: float = 1.0  # side of the mirror
    circle: float = 0.0  # diameter of the circle of confusion

    @property
    def interpolated(self) -> MirrorPointSpread:
        """The part of it that the interpolation takes, rounded; the filter does the rest."""
        blur = _rounded(min(self.blur, WIDEST_BLUR))
        return MirrorPointSpread(max(blur, MIN_BLUR), self.fill, _rounded(min(self.circle, WIDEST_CIRCLE)))

    def modulation(self, frequency: Floats) -> Floats:
        """Compute by how much waves along an axis are weakened."""
        gaussian = np.exp(-2 * (np.pi * self.blur * frequency) ** 2)
        return np.asarray(
            np.sinc(self.fill * frequency) * gaussian * _disc_modulation(self.circle * frequency)
        )

    def profile(self, x: Floats) -> Floats:
        """Compute the light of a mirror at distances along an axis, integrated over the other axis."""
        # a disc integrated over one axis is a semicircle, for which this quadrature is Gauss's
        nodes = 12 if self.circle else 1
        angle = np.arange(1, nodes + 1) * np.pi / (nodes + 1)
        total = np.zeros(np.shape(x))
        for at, share in zip(
            self.circle / 2 * np.cos(angle), 2 / (nodes + 1) * np.sin(angle) ** 2, strict=True
        ):
            right, left = ((x - at + side * self.fill / 2) / (math.sqrt(2) * self.blur) for side in (1, -1))
            total += share * (erf(right) - erf(left)) / (2 * self.fill)
        return total


@dataclass(frozen=True, eq=False)
class Interpolation:
    """Interpolation between mirrors, and the filter that goes before it."""

    weights: NDArray[np.float32]  # (STEPS + 1
    filter: Floats  # (2r + 1,) weights along each axis, adding up to 1


@lru_cache(maxsize=256)
def interpolation(spread: MirrorPointSpread) -> Interpolation:
    weights, gain = _interpolation_weights(spread.interpolated)
    wider = math.sqrt(max(spread.blur**2 - WIDEST_BLUR**2, 0.0))
    gain_of_filter = spread.modulation(_FREQUENCIES) / gain
    return Interpolation(weights.astype(np.float32), _fit_filter(gain_of_filter, 8 + math.ceil(5 * wider)))


@lru_cache(maxsize=1024)
def _interpolation_weights(spread: MirrorPointSpread) -> tuple[Floats, Floats]:
    """Solve for the weights (STEPS + 1, TAPS), and for the modulation that they leave at each frequency."""
    # At each frequency the waves that the weights give at the places x shall be those of `spread` but for one
    # common factor, so what is minimised is their component across those of `spread`. The interpolation is
    # symmetric: weights are solved for x >= 0, and mirrored. Their sum is the light of white mirrors,
    # exactly: it is even only where mirrors fill their squares.
    places = np.arange(STEPS // 2 + 1) / STEPS
    near, goal = _waves_and_light(spread, places)
    count, size = len(places), len(places) * TAPS
    share = np.where(_FREQUENCIES <= BAND, 1.0, _REST)
    squares = np.einsum("f,fpa,fpb->pab", share + _PULL, near.conj(), near).real
    along = np.einsum("fpa,fp->fpa", near.conj(), goal).real.reshape(-1, size)
    system = np.zeros((size + count, size + count))
    for p in range(count):
        place = slice(p * TAPS, (p + 1) * TAPS)
        system[place, place] = squares[p]
        system[size + p, place] = system[place, size + p] = 1.0
    power = (np.abs(goal) ** 2).sum(axis=1)
    system[:size, :size] -= (along.T * (share / power)) @ along
    solved = np.linalg.solve(system, np.append(_PULL * along.sum(axis=0), goal[0].real))[:size]
    half = solved.reshape(-1, TAPS)
    return np.concatenate([half[:0:-1, ::-1], half]), along @ solved / power * spread.modulation(_FREQUENCIES)


def _waves_and_light(
    spread: MirrorPointSpread, places: Floats
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Give waves of all frequencies at the nearest mirrors, and the light `spread` makes of them."""
    # returns near (frequencies, places, TAPS), goal (frequencies, places)

    def wave(mirrors: NDArray[np.intp]) -> NDArray[np.complex128]:
        turns = _FREQUENCIES[:, None, None] * (mirrors - places[:, None])
        return np.asarray(np.exp(2j * np.pi * turns))

    goal = (spread.profile(places[:, None] - _MIRRORS) * wave(_MIRRORS)).sum(axis=-1)
    return wave(np.arange(TAPS) - TAPS // 2), goal


def _rounded(size: float, step: float = 0.0025) -> float:
    """Round a spread in mirrors, for few interpolations to be solved; images differ by at most 3 %."""
    return round(size / step) * step


@lru_cache(maxsize=256)
def square_to_disc_correction(circle: float) -> Floats | None:
    """Make the filter, in both directions, that turns an interpolated circle of confusion into a disc."""
    # The interpolation of a circle goes axis by axis, with an axis-wise product of semicircles in place of a
    # disc, and no wider than `WIDEST_CIRCLE`. Up to one mirror, fringes do not show the difference.
    # returns (2r + 1, 2r + 1)
    if circle <= 1.0:
        return None
    reach = 2 + math.ceil(circle / 2)
    x, y = (axis.ravel() for axis in np.meshgrid(_FREQUENCIES[::2], _FREQUENCIES[::2]))
    once = x >= y
    x, y = x[once], y[once]
    narrow = min(circle, WIDEST_CIRCLE)
    modulation = _disc_modulation(circle * np.hypot(x, y))
    modulation /= _disc_modulation(narrow * x) * _disc_modulation(narrow * y)
    weight = np.where(np.maximum(x, y) <= BAND, 1.0, math.sqrt(_REST))
    across, down = (axis.ravel() for axis in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    near, far = np.sort(np.abs([across, down]), axis=0)
    # One number for all places that symmetries of the square map to each other.
    orbit = near + far * (far + 1) // 2
    waves = np.zeros((len(x), orbit.max() + 1))
    np.add.at(waves.T, orbit, np.cos(2 * np.pi * (np.outer(across, x) + np.outer(down, y))))
    solved = np.linalg.lstsq(waves * weight[:, None], modulation * weight, rcond=None)[0]
    kernel = solved[orbit].reshape(2 * reach + 1, 2 * reach + 1)
    return np.asarray(kernel / kernel.sum())


def _disc_modulation(periods: Floats) -> Floats:
    """Compute by how much a disc weakens waves with the given number of periods across it."""
    x = np.pi * np.asarray(periods, np.float64)
    return np.divide(2 * j1(x), x, out=np.ones_like(x), where=np.abs(x) > 1e-9)


def _fit_filter(modulation: Floats, reach: int) -> Floats:
    """Fit a symmetric filter (2 reach + 1,) to a gain at each frequency."""
    order = np.arange(reach + 1)
    cosines = np.where(order == 0, 1.0, 2.0) * np.cos(2 * np.pi * np.outer(_FREQUENCIES, order))
    weight = np.where(_FREQUENCIES <= BAND, 1.0, math.sqrt(_REST))[:, None]
    half = np.linalg.lstsq(cosines * weight, modulation * weight[:, 0], rcond=None)[0]
    whole = np.concatenate([half[:0:-1], half])
    return np.asarray(whole / whole.sum())
