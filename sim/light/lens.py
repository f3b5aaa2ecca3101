"""Sample points on the lens, one for each sub-pixel.

Every pixel turns all its points by a random angle, so the sampling error of few points becomes noise from
pixel to pixel, but only if the mean and covariance of the points are right. Half of the points are therefore
the other half mirrored at the centre, both on the lens and in the pixel: the mean ray of every pixel then
passes its centre, and edges are blurred symmetrically. The points' covariance is that of the disc, and they
are correlated with the places in the pixel as little as possible.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.core.geometry import Pinhole
from sim.scene import SubpixelView
from sim.world import World
from sim.world.render import subpixel_shifts

GOLDEN_RAD = np.pi * (3 - np.sqrt(5))  # the golden angle in rad


def lens_views(side: int, aperture_mm: float) -> list[SubpixelView]:
    """Choose `side` by `side` points of every pixel, each with a point of a lens that is open."""
    places = subpixel_shifts(side)
    if not aperture_mm:
        return [SubpixelView(place) for place in places]
    return [SubpixelView(place, lens) for place, lens in zip(places, lens_points(len(places)), strict=True)]


@lru_cache
def lens_points(places: int) -> tuple[tuple[float, float], ...]:
    """Choose points of the unit disc, one for each sub-pixel in reading order."""
    # returns (float, float)
    pairs, alone = divmod(places, 2)
    if not pairs:
        return ((0.0, 0.0),) * places
    side = round(np.sqrt(places))
    half = _least_correlated(np.array(subpixel_shifts(side)[:pairs]), _half_disc(pairs, alone))
    points = np.concatenate([half, np.zeros((alone, 2)), -half[::-1]])
    return tuple((float(x), float(y)) for x, y in points)


def _half_disc(pairs: int, alone: int) -> Floats:
    """Place one of each pair (pairs, 2) on Vogel's spiral; with the others the covariance is the disc's."""
    n = np.arange(pairs)
    radius, angle = np.sqrt((2 * n + 1 + alone) / (2 * pairs + alone)), n * GOLDEN_RAD / 2
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    power, axes = np.linalg.eigh(2 * points.T @ points / (2 * pairs + alone))
    return np.asarray(points @ axes @ np.diag(0.5 / np.sqrt(power)) @ axes.T)


def _least_correlated(places: Floats, points: Floats) -> Floats:
    """Order and mirror the points so that they are least correlated with the places."""
    random = np.random.default_rng(0)
    orders = [random.permutation(points) * random.choice([-1.0, 1.0], (len(points), 1)) for _ in range(500)]
    return min(orders, key=lambda order: float(np.abs(places.T @ order).max()))


def vignetting(world: World) -> NDArray[np.float32] | None:
    """Compute the lens's transmission to each pixel, relative to the axis."""
    # returns (height, width)
    exponent = world.camera.vignetting
    if exponent == 0:
        return None
    camera = world.camera_model()
    cosine = _cosine_to_axis(camera.size, tuple(camera.matrix.ravel()), tuple(camera.distortion))
    return np.asarray(cosine ** np.float32(exponent))


@lru_cache(maxsize=2)
def _cosine_to_axis(
    size: tuple[int, int], matrix: tuple[float, ...], distortion: tuple[float, ...]
) -> NDArray[np.float32]:
    """Cosine of the angle between each pixel's ray and the optical axis, (height, width)."""
    camera = Pinhole(size, np.reshape(matrix, (3, 3)), np.array(distortion))
    v, u = np.mgrid[0 : size[1], 0 : size[0]].astype(np.float64)
    slopes = camera.normalise(np.stack([u, v], axis=-1))
    return np.asarray((1 + (slopes**2).sum(axis=-1)) ** -0.5, np.float32)
