"""How the light on a flat item changes with what its pixels see, and as it moves.

A pixel's light is the reflectance at the place (x, y) of the item that it sees, times the light of the place
(u, v) of the projector's image that falls there. Both derivatives come with the light from one pass over its
samples. The derivatives of the four places by the item's place are plain geometry, equal for all samples of a
pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from fpplab.core.conventions import Floats
from sim.light.look_up import light_with_slopes
from sim.light.table import Irradiance, LightTable
from sim.texture import PatternTextures


@dataclass(frozen=True, eq=False)
class MotionTable:
    """A table of light with its derivatives."""

    table: LightTable  # of K samples of each of its h * w = P pixels
    slopes: Irradiance  # (K, P, 2), of the shade by the place (x, y) on the item that is seen, per mm
    albedo_slopes: Irradiance  # (P, 2), of the reflectance, averaged over samples
    motion: Irradiance  # (P, 5, 3), by the item's place in the camera's frame in mm

    @property
    def nbytes(self) -> int:
        own = self.slopes.nbytes + self.albedo_slopes.nbytes + self.motion.nbytes
        return self.table.nbytes + own

    def look_up(self, textures: PatternTextures) -> Irradiance:
        # returns (n, P, 5) mm
        assert textures.weights is not None
        views, h, w, _ = self.table.samples.shape
        terms = np.empty((textures.texels.shape[-1], h * w, 5), np.float32)
        x, y = map(np.float32, textures.origin)
        flat = self.table.samples.reshape(views, h * w, 4)
        light_with_slopes(textures.texels, textures.weights, flat, self.slopes, x, y, terms)
        return terms

    def displaced(self, terms: Irradiance, moves: Floats, room: Irradiance | np.float32) -> Irradiance:
        """Compute the light on the displaced item to first order, other light included."""
        # terms (n, P, 5); moves (n, 3) mm; room (height, width); returns (n, height, width)
        _, h, w, _ = self.table.samples.shape
        left, top = self.table.corner
        height, width = self.table.albedo.shape
        light = np.empty((len(terms), h * w), np.float32)
        even = np.broadcast_to(np.asarray(room, np.float32), self.table.albedo.shape)
        albedo, elsewhere = (
            values[top : top + h, left : left + w].ravel() for values in (self.table.albedo, even)
        )
        _displace(terms, self.motion, moves, elsewhere, albedo, self.albedo_slopes, light)
        pictures = np.zeros((len(terms), height, width), np.float32)
        pictures[:, top : top + h, left : left + w] = light.reshape(-1, h, w)
        return pictures


@numba.njit(parallel=True, cache=True)
def _displace(
    terms: Irradiance,
    motion: Irradiance,
    moves: Floats,
    room: Irradiance,
    albedo: Irradiance,
    albedo_slopes: Irradiance,
    out: Irradiance,
) -> None:
    for p in numba.prange(len(albedo)):
        for n in range(len(out)):
            total = terms[n, p, 0] + room[p] * albedo[p]
            for axis in range(3):
                by = terms[n, p, 0] * motion[p, 0, axis]
                for place in range(1, 5):
                    by += terms[n, p, place] * motion[p, place, axis]
                for place in range(2):
                    by += room[p] * albedo_slopes[p, place] * motion[p, 1 + place, axis]
                total += np.float32(moves[n, axis]) * by
            out[n, p] = max(total, np.float32(0))
