"""Depths of pixels that move, by maximum likelihood: all sets see a point with one offset and modulation.

At uneven steps a set may tell its phase badly, and orders by phases of single sets are then wrong. Levels of
all sets together still tell the depth within a range.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.phase.limits import MOTION


@dataclass(frozen=True, eq=False)
class LikelyDepths:
    """Where in the range each pixel most likely is, and what fits its levels there."""

    place: Floats  # (P,) from -1 to 1
    offset: Floats  # (P,)
    modulation: Floats  # (N, P)
    residual: Floats  # (N, P)
    gap: Floats  # (P,) by how much more squares another order leaves in a patch
    noise: Floats  # (P,) of the place, over that by even steps


def likely_depths(levels: Floats, bent: Floats, sets: NDArray[np.intp]) -> LikelyDepths:
    """Find the place of each pixel, of one order in each patch.

    `levels` (N, P) are of all frames, those of a patch one after another, `bent` (3, N, P) their phases in
    rad as coefficients of 1, place and its square, and `sets` (N,) the set of each, from 0.
    """
    levels = levels - (middle := levels.mean(axis=0))
    fastest, contrast = np.abs(bent[1]).max(axis=0), np.ones((len(sets), 1))
    tried = int(np.ceil(MOTION.candidates_per_period * fastest.max() / np.pi)) + 2
    places = np.linspace(-1.0, 1.0, tried)
    powers = np.stack([_of_patches(_misfit(levels, np.cos(_phases(bent, place)))) for place in places])
    # Depths between those tried may suit better than the best of these.
    refined, misfits = list[Floats](), list[Floats]()
    for _ in range(MOTION.refined_orders):
        place = places[powers.argmin(axis=0)]
        powers[np.abs(places[:, None] - place) * fastest < 0.5 * np.pi] = np.inf
        for _ in range(MOTION.place_steps):
            place, _, residual, _ = _stepped(levels, bent, contrast, place)
        refined.append(place)
        misfits.append(_of_patches(np.sum(residual**2, axis=0)))
    place = np.take_along_axis(np.stack(refined), np.argmin(misfits, axis=0)[None], axis=0)[0]
    for _ in range(MOTION.place_steps):
        shown = contrast
        place, values, residual, noise = _stepped(levels, bent, shown, place)
        contrast = _contrasts(levels, values, np.cos(_phases(bent, place)), residual, sets)
    gap = MOTION.patch_px**2 * -np.subtract(*np.sort(misfits, axis=0)[:2])
    return LikelyDepths(place, values[0] + middle, values[1] * shown, residual, gap, noise)


def _of_patches(power: Floats) -> Floats:
    """Give each pixel the mean over its patch."""
    return np.repeat(power.reshape(-1, MOTION.patch_px**2).mean(axis=1), MOTION.patch_px**2)


def _phases(bent: Floats, place: Floats | float) -> Floats:
    return np.asarray(bent[0] + place * (bent[1] + place * bent[2]))


def _misfit(levels: Floats, waves: Floats) -> Floats:
    """Squares that an offset and a modulation above 0 leave of levels whose mean is 0."""
    waves = waves - waves.mean(axis=0)
    along = np.maximum(np.sum(levels * waves, axis=0), 0.0)
    return np.asarray(np.sum(levels**2, axis=0) - along**2 / np.maximum(np.sum(waves**2, axis=0), 1e-9))


def _stepped(
    levels: Floats, bent: Floats, contrast: Floats, place: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """One step of Gauss and Newton; offset and modulation before it, what they leave, and its noise."""
    phase, slope = _phases(bent, place), bent[1] + 2.0 * place * bent[2]
    fit = np.stack([np.ones_like(phase), contrast * np.cos(phase)])
    inverse = np.linalg.inv(np.einsum("inp,jnp->pij", fit, fit) + 1e-9 * np.eye(2))
    values = np.einsum("pij,jnp,np->ip", inverse, fit, levels, optimize=True)
    residual = levels - np.einsum("ip,inp->np", values, fit)
    even = 0.5 * np.sum((values[1] * contrast * slope) ** 2, axis=0)
    change = -values[1] * contrast * np.sin(phase) * slope
    change -= np.einsum("pij,jnp,np,imp->mp", inverse, fit, change, fit, optimize=True)
    limit = 0.5 / np.abs(bent[1]).max(axis=0)
    own = np.maximum(np.sum(change**2, axis=0), 1e-9)
    step = np.clip(np.sum(change * residual, axis=0) / own, -limit, limit)
    return np.clip(place + step, -1.0, 1.0), values, residual, np.sqrt(even / own)


def _contrasts(
    levels: Floats, values: Floats, waves: Floats, residual: Floats, sets: NDArray[np.intp]
) -> Floats:
    """Modulation of each frame's set relative to all, (N, 1), by the half of the pixels that fit best."""
    power = np.sum(residual**2, axis=0)
    good = power <= np.median(power)
    shown = values[1, good] * waves[:, good]
    crossed, own = (np.sum(shown * each, axis=1) for each in (levels[:, good] - values[0, good], shown))
    ratios = np.bincount(sets, crossed) / np.maximum(np.bincount(sets, own), 1e-9)
    return np.asarray(np.maximum(ratios / ratios.mean(), 0.1)[sets][:, None])
