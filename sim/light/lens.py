"""Where rays pass the lens: one point for each place in a pixel that is looked at.

A pixel turns all its points by a random angle, so what few of them get wrong is noise from pixel to pixel,
but only if every pixel's spread is right on average. Half of the points are therefore the other half seen
from the opposite side, on the lens and in the pixel alike: no pixel then looks beside its centre, and an edge
in the picture is as far from its blur's one end as from the other's. Their covariance is the disc's, and they
follow the places in the pixel as little as can be.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fpplab.core.conventions import Floats
from sim.world.render import shifts

TRIES = 500
GOLDEN_RAD = np.pi * (3 - np.sqrt(5))


@lru_cache
def lens_points(places: int) -> tuple[tuple[float, float], ...]:
    """Points of the unit disc, one for each of `places` square places of a pixel in reading order.

    places: a square number, for a pixel of side by side equal squares.
    """
    pairs, alone = divmod(places, 2)
    if not pairs:
        return ((0.0, 0.0),) * places
    side = round(np.sqrt(places))
    half = _least_bound(np.array(shifts(side)[:pairs]), _half_disc(pairs, alone))
    points = np.concatenate([half, np.zeros((alone, 2)), -half[::-1]])
    return tuple((float(x), float(y)) for x, y in points)


def _half_disc(pairs: int, alone: int) -> Floats:
    """One of each pair (pairs, 2), on Vogel's spiral; with the other, the covariance is that of the disc."""
    n = np.arange(pairs)
    radius, angle = np.sqrt((2 * n + 1 + alone) / (2 * pairs + alone)), n * GOLDEN_RAD / 2
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    power, axes = np.linalg.eigh(2 * points.T @ points / (2 * pairs + alone))
    return np.asarray(points @ axes @ np.diag(0.5 / np.sqrt(power)) @ axes.T)


def _least_bound(places: Floats, points: Floats) -> Floats:
    """The points in that order, and on that side, in which they follow the places least."""
    random = np.random.default_rng(0)
    orders = [random.permutation(points) * random.choice([-1.0, 1.0], (len(points), 1)) for _ in range(TRIES)]
    return min(orders, key=lambda one: float(np.abs(places.T @ one).max()))
