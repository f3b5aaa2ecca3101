"""Vignetting: how much light the camera's lens passes to each pixel."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fpplab.core.geometry import Pinhole
from sim.world import World


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
