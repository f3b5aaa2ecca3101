"""The exponent of a bent response, from phases of three images that must agree on a position.

Three images show no harmonics, but these shift their phase three times in a period. Where a wide set
predicts the phase of a finer one, its own shift is magnified by the ratio of their stripes, and the two
contradict each other. The exponent that takes the shifts off best is that of the response.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from fpplab.core.conventions import TWO_PI, Floats, phase_steps
from fpplab.phase.limits import BENT_PHASES, COMMON_ERRORS, NOISE
from fpplab.phase.unwrapping import WavelengthSequence

_THIRD = 1.0 / 3.0
_PHASES = TWO_PI * np.linspace(0.0, _THIRD, 65)  # phases over a period of the shift at which it is computed


def exponent_of_phases(phases: Floats, origins_rad: Floats, sequences: Sequence[WavelengthSequence]) -> float:
    """Find the exponent at which the phases agree best; NaN where they agree at none."""
    # phases (S, P) rad, of the patterns as they are shown; origins_rad (S,)
    every = slice(None, None, max(1, phases.shape[1] // BENT_PHASES.pixels))
    turns, origins = phases[:, every] / TWO_PI % 1.0, origins_rad[:, None] / TWO_PI
    compared = [sequence for sequence in sequences if len(sequence.wavelengths) > 1]
    if not compared:
        return float("nan")

    def contradiction(share: float) -> float:
        straight, stretch = _without_shift(turns, exponent_of_second_harmonic(share))
        variances = [v for s in compared for v in _contradictions(straight - origins, s)] or [math.inf]
        # Where phases are drawn together, so is their noise, which is no agreement.
        return float(np.mean(variances)) / stretch

    ratio = max(f.stripes / c.stripes for s in compared for c, f in pairwise(s.wavelengths))
    trials = BENT_PHASES.min_trials + math.ceil(BENT_PHASES.trials_per_ratio * ratio)
    shares = np.linspace(*BENT_PHASES.second_harmonics, trials)
    tried = np.array([contradiction(share) for share in shares])
    if tried.min() > BENT_PHASES.max_contradiction:
        return float("nan")
    # Noise alone leaves the least contradiction; where phases say little, what is expected decides.
    weight = turns.shape[1] / max(float(tried.min()), BENT_PHASES.min_contradiction)

    def cost(share: float) -> float:
        return weight * contradiction(share) + (share / COMMON_ERRORS.harmonic_prior) ** 2

    costs = weight * tried + (shares / COMMON_ERRORS.harmonic_prior) ** 2
    best = int(np.clip(np.argmin(costs), 1, trials - 2))
    step = float(shares[1] - shares[0])
    share = _vertex(float(shares[best]), step, costs[best - 1 : best + 2])
    step *= BENT_PHASES.refinement
    near = np.array([cost(share + k * step) for k in (-1, 0, 1)])
    return exponent_of_second_harmonic(_vertex(share, step, near))


def _vertex(middle: float, step: float, costs: Floats) -> float:
    """Find the least value of the parabola through three, at most a step from the middle."""
    before, here, after = costs
    bend = before - 2.0 * here + after
    return middle + step * float(np.clip(0.5 * (before - after) / max(bend, 1e-12), -1.0, 1.0))


def exponent_of_second_harmonic(share: float) -> float:
    """Give the exponent whose second harmonic is `c = (g - 1)/(g + 2)` of the fringe."""
    return (1.0 + 2.0 * share) / (1.0 - share)


def _without_shift(turns: Floats, exponent: float) -> tuple[Floats, float]:
    """Take off the phases of three images what a power law adds, and say by how much that stretches them."""
    shifts = phase_steps(3)
    light = (0.5 + 0.5 * np.cos(_PHASES - shifts[:, None])) ** exponent
    added = np.angle(np.exp(1j * shifts) @ light * np.exp(-1j * _PHASES)) / TWO_PI
    shown, within = _PHASES / TWO_PI + added, turns % _THIRD
    slope = np.interp(within, shown, np.gradient(_PHASES / TWO_PI, shown))
    return turns - np.interp(within, shown, added), float(np.mean(slope**2))


def _contradictions(turns: Floats, sequence: WavelengthSequence) -> Iterator[float]:
    """How far each wavelength's phase is from that which the coarser ones predict, as a variance in rad²."""
    own, (base, *finer) = turns[list(sequence.sets)], sequence.wavelengths
    first = np.array(base.coefficients, np.float64) @ own % 1.0
    # At its ends the base may be off by a whole period.
    inner = np.abs(first - 0.5) < 0.5 - BENT_PHASES.end_turns
    if inner.sum() < NOISE.min_pixels:
        return
    own, position = own[:, inner], first[inner] / base.stripes
    for wavelength in finer:
        measured = np.array(wavelength.coefficients, np.float64) @ own % 1.0
        off = position * wavelength.stripes - measured
        # A constant difference, as of a wrong phase origin, is no contradiction.
        yield float(-2.0 * np.log(np.abs(np.mean(np.exp(1j * TWO_PI * off)))))
        position = (np.floor(off + 0.5) + measured) / wavelength.stripes
