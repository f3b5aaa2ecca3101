"""Projector mirrors as a texture: from the light of each mirror to the light that leaves the lens.

The texture is a square lattice with one texel per mirror. On the diamond lattice mirror (i, j) is centred at
u = i + 0.5 (j mod 2), v = j, so with s = u + v/2 and t = u - v/2 every centre is an integer (s, t): the
diamond is a square lattice turned by 45 degrees. Its cells are squares also in space, where a row of mirrors
is half a column high.

Optics: a mirror fills the share f of its unit square, so it is a square of variance f/12 along each side, and
the lens blurs it with a point-spread of standard deviation `blur`, in mirrors. Linear interpolation between
texels is a tent of variance 1/6, so the texels are blurred by the Gaussian of variance `blur² + f/12 - 1/6`:
together they have the variance of mirror and lens. Out of focus the circle of confusion, a disc of
variance D²/16, comes on top. `blur = 0` means ideal mirrors with sharp edges, which no real lens shows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ive

from fpplab.core.conventions import Floats, Lattice, mirror_centres


def least_blur(fill_factor: float) -> float:
    """Compute the smallest point spread that linear interpolation of texels can represent.

    Parameters
    ----------
    fill_factor : float
        Share of its square that a mirror fills.

    Returns
    -------
    float
        Standard deviation in mirrors.
    """
    return math.sqrt(1 / 6 - fill_factor / 12)


Texels = NDArray[np.float32]
"""A texture (rows, columns)."""
Part = tuple[int, int, int, int]
"""Texels (left, top, right, bottom) of a texture, the right and bottom ones excluded."""


@dataclass(frozen=True)
class MirrorTexture:
    """The texture of a projector.

    Attributes
    ----------
    size : tuple of int
        (columns, rows) of mirrors.
    lattice : Lattice
        How the mirrors are arranged.
    blur : float
        Standard deviation of the lens's point spread in mirrors, 0 or at least `least_blur`.
    fill_factor : float
        Share of its square that a mirror fills.
    widest : float
        Diameter of the greatest circle of confusion that will be asked for, in texels.
    """

    size: tuple[int, int]
    lattice: Lattice
    blur: float
    fill_factor: float = 1.0
    widest: float = 0.0

    @property
    def exact(self) -> bool:
        """Whether mirrors have sharp edges."""
        return self.blur == 0

    @property
    def fill(self) -> float:
        """Side of a mirror, in texels."""
        return math.sqrt(self.fill_factor)

    @property
    def texels_per_column(self) -> float:
        """Texels per column of mirrors; on the diamond lattice nearest neighbours lie at 45 degrees."""
        return math.sqrt(2.0) if self.lattice is Lattice.DIAMOND else 1.0

    @property
    def _variance(self) -> float:
        """Variance of the Gaussian that remains to be applied, in texels squared."""
        return 0.0 if self.exact else max(self.blur**2 + self.fill_factor / 12 - 1 / 6, 0.0)

    @property
    def _margin(self) -> int:
        return 2 + _reach(math.sqrt(self._variance)) + math.ceil(self.widest / 2)

    @property
    def _layout(self) -> _Layout:
        return _layout(self.size, self.lattice, self._margin)

    @property
    def affine(self) -> Floats:
        """(2, 3): projector pixels (u, v, 1) to texture (column, row); texel centres are integers."""
        return _affine(self.size, self.lattice, self._margin)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the texture, dark margin included."""
        rows, columns = self._layout.mirrors.shape
        return rows, columns

    def spread(self, light: NDArray[np.float32], circle: float = 0.0, part: Part | None = None) -> Texels:
        """Make the texture of mirrors with given light; dark outside.

        Parameters
        ----------
        light : ndarray of float32
            Of every mirror, (rows, columns).
        circle : float
            Diameter of the circle of confusion in texels, at most `widest`.
        part : Part or None
            Region of the texture to return; None for all of it.

        Returns
        -------
        Texels
            (rows, columns) of the texture or of its part.
        """
        return self.spreads(light, (circle,), part)[0]

    def spreads(
        self, light: NDArray[np.float32], circles: Sequence[float], part: Part | None = None
    ) -> list[Texels]:
        """Make the textures for several circles of confusion, placing the mirrors once.

        Parameters
        ----------
        light : ndarray of float32
            Of every mirror, (rows, columns).
        circles : sequence of float
            Diameters in texels, at most `widest`.
        part : Part or None
            Region of the texture to return; None for all of it.

        Returns
        -------
        list of Texels
            One for each circle, as from `spread`.
        """
        kernels = [self._kernels(circle) for circle in circles]
        reach = max(sum(len(k) // 2 for k in pair if k is not None) for pair in kernels)
        sharp, inside = self._sharp(light, part, reach)
        return [_blurred(sharp, *pair)[inside] for pair in kernels]

    def _kernels(self, circle: float) -> tuple[Floats | None, Floats | None]:
        """Make the kernel of the Gaussian along each axis, and that of the disc, None where not needed."""
        variance, disc = self._variance, None
        if circle > _SMALL_DISC:
            disc = _disc_of(circle)
        elif circle > 0:
            variance += circle**2 / 16
        return (_gaussian(math.sqrt(variance)) if variance > 0 else None), disc

    def _sharp(
        self, light: NDArray[np.float32], part: Part | None, reach: int
    ) -> tuple[Texels, tuple[slice, slice]]:
        """Make the unblurred texture of a part and `reach` texels around it; say where in it the part is."""
        if part is None:
            texture = np.zeros(self.shape, np.float32)
            np.put(texture, self._layout.places, light)
            return texture, (slice(None), slice(None))
        left, top, right, bottom = part
        x, y = max(left - reach, 0), max(top - reach, 0)
        mirrors = self._layout.mirrors[y : bottom + reach, x : right + reach]
        texture = np.where(mirrors >= 0, np.take(light, mirrors), np.float32(0))
        return texture, (slice(top - y, bottom - y), slice(left - x, right - x))


def _blurred(texture: Texels, gaussian: Floats | None, disc: Floats | None) -> Texels:
    if gaussian is not None:
        texture = np.asarray(
            cv2.sepFilter2D(texture, -1, gaussian, gaussian, borderType=cv2.BORDER_CONSTANT), np.float32
        )
    if disc is not None:
        texture = np.asarray(cv2.filter2D(texture, -1, disc, borderType=cv2.BORDER_CONSTANT), np.float32)
    return texture


def _affine(size: tuple[int, int], lattice: Lattice, margin: int) -> Floats:
    if lattice is Lattice.SQUARE:
        return np.array([[1.0, 0.0, margin], [0.0, 1.0, margin]])
    least_t = -((size[1] - 1) // 2) - (size[1] - 1) % 2
    return np.array([[1.0, 0.5, margin], [1.0, -0.5, margin - least_t]])


@dataclass(frozen=True, eq=False)
class _Layout:
    """Where mirrors and texels lie.

    places: (rows, columns) of mirrors, the flat index of every mirror's texel. mirrors: (rows, columns) of
    the texture, the flat index of every texel's mirror, -1 where there is none.
    """

    places: NDArray[np.intp]
    mirrors: NDArray[np.int32]


@lru_cache(maxsize=8)
def _layout(size: tuple[int, int], lattice: Lattice, margin: int) -> _Layout:
    u, v = mirror_centres(size, lattice)
    column, row = np.einsum("ij,jvu->ivu", _affine(size, lattice, margin), np.stack([u, v, np.ones_like(u)]))
    rows, columns = np.rint(row).astype(np.intp), np.rint(column).astype(np.intp)
    shape = int(rows.max()) + margin + 1, int(columns.max()) + margin + 1
    places = np.ravel_multi_index((rows, columns), shape)
    mirrors = np.full(shape, -1, np.int32)
    np.put(mirrors, places, np.arange(places.size, dtype=np.int32))
    return _Layout(places, mirrors)


_SMALL_DISC = 2.0
"""Diameter in texels up to which a disc is replaced by a Gaussian of the same variance."""


@lru_cache(maxsize=64)
def _disc_of(circle: float) -> Floats:
    """Draw a disc whose variance on whole texels is that of a circle of confusion."""

    def excess(diameter: float) -> float:
        disc = _disc(diameter)
        place = np.arange(len(disc)) - len(disc) // 2
        return float(disc.sum(axis=0) @ place**2) - circle**2 / 16

    return _disc(float(brentq(excess, 0.5, circle + 1, xtol=1e-4)))


def _disc(diameter: float) -> Floats:
    """Share of each texel that a disc covers, by 15 x 15 points in each, normalised."""
    reach = math.ceil(diameter / 2 - 0.5)
    fine = (np.arange((2 * reach + 1) * 15) + 0.5) / 15 - reach - 0.5
    covered = (fine[:, None] ** 2 + fine**2 <= diameter**2 / 4).astype(np.float64)
    side = 2 * reach + 1
    shares = covered.reshape(side, 15, side, 15).mean(axis=(1, 3))
    return np.asarray(shares / shares.sum())


def _reach(sigma: float) -> int:
    """Texels on either side that a blur spreads to."""
    return 1 + math.ceil(5 * sigma)


def _gaussian(sigma: float) -> Floats:
    """Make the discrete Gaussian `exp(-t) I_n(t)`, t = σ², whose variance is σ² exactly (Lindeberg 1990)."""
    kernel = ive(np.arange(-_reach(sigma), _reach(sigma) + 1), sigma**2)
    return np.asarray(kernel / kernel.sum(), np.float64)
