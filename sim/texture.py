"""Mirrors as a texture: from the grey level of each mirror to the light that leaves the lens.

The texture is a square lattice with one texel per mirror. On the diamond lattice mirror (i, j) is centred at
u = i + 0.5 (j mod 2), v = j, so with s = u + v/2 and t = u - v/2 every centre is an integer (s, t): the
diamond is a square lattice turned by 45 degrees. Its cells are squares also in space, where a row of mirrors
is half a column high.

Optics: a mirror is a unit square of variance 1/12 along each side, and the lens blurs it with a point-spread
of standard deviation `blur`, in mirrors. Linear interpolation between texels is a tent of variance 1/6, so
the texels are blurred by the Gaussian of variance `blur² + 1/12 - 1/6`: the whole has the variance of both.
`blur = 0` are ideal mirrors with sharp edges, which no lens shows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from fpplab.conventions import Floats, Lattice, mirror_centres

LEAST_BLUR = math.sqrt(1 / 12)
"""The least point-spread that linear interpolation can stand for, in mirrors."""

Texels = NDArray[np.float32]


@dataclass(frozen=True)
class MirrorTexture:
    """The texture of a projector. size: (columns, rows) of mirrors. blur: in mirrors, 0 or >= LEAST_BLUR."""

    size: tuple[int, int]
    lattice: Lattice
    blur: float

    @property
    def exact(self) -> bool:
        """Whether mirrors have sharp edges."""
        return self.blur == 0

    @property
    def _sigma(self) -> float:
        return math.sqrt(max(self.blur**2 - 1 / 12, 0.0)) if not self.exact else 0.0

    @property
    def _margin(self) -> int:
        return 1 + _reach(self._sigma)

    @cached_property
    def affine(self) -> Floats:
        """(2, 3): projector pixels (u, v, 1) to texture (column, row); texel centres are integers."""
        if self.lattice is Lattice.SQUARE:
            return np.array([[1.0, 0.0, self._margin], [0.0, 1.0, self._margin]])
        least_t = -((self.size[1] - 1) // 2) - (self.size[1] - 1) % 2
        return np.array([[1.0, 0.5, self._margin], [1.0, -0.5, self._margin - least_t]])

    @cached_property
    def _texels(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """(rows, columns) of the texel of every mirror."""
        u, v = mirror_centres(self.size, self.lattice)
        column, row = np.einsum("ij,jvu->ivu", self.affine, np.stack([u, v, np.ones_like(u)]))
        return np.rint(row).astype(np.intp), np.rint(column).astype(np.intp)

    @cached_property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the texture, dark margin included."""
        rows, columns = self._texels
        return int(rows.max()) + self._margin + 1, int(columns.max()) + self._margin + 1

    def spread(self, light: NDArray[np.float32]) -> Texels:
        """The texture of mirrors that give `light` (rows, columns of mirrors), float32; dark outside."""
        texture = np.zeros(self.shape, np.float32)
        texture[self._texels] = light
        if self._sigma > 0:
            kernel = _gaussian(self._sigma)
            cv2.sepFilter2D(texture, -1, kernel, kernel, dst=texture, borderType=cv2.BORDER_CONSTANT)
        return texture


def _reach(sigma: float) -> int:
    """Texels on either side that a blur spreads to."""
    return 1 + math.ceil(5 * sigma)


def _gaussian(sigma: float) -> Floats:
    """The discrete Gaussian `exp(-t) I_n(t)`, t = σ², whose variance is σ² exactly (Lindeberg 1990)."""
    kernel = ive(np.arange(-_reach(sigma), _reach(sigma) + 1), sigma**2)
    return np.asarray(kernel / kernel.sum(), np.float64)
