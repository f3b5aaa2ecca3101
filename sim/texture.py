"""Projector mirrors as a texture: from the light of each mirror to the light that leaves the lens.

The texture is a square lattice with one texel per mirror. On the diamond lattice mirror (i, j) is centred at
u = i + 0.5 (j mod 2), v = j, so with s = u + v/2 and t = u - v/2 every centre is an integer (s, t): the
diamond is a square lattice turned by 45 degrees. Its cells are squares also in space, where a row of mirrors
is half a column high.

Optics: `sim.mirror_spread` says how the light of a mirror spreads and splits it in two, a filter of the
mirrors' levels and an interpolation between the nearest mirrors. The texture holds the filtered levels. `blur
= 0` means ideal mirrors with sharp edges, which no real lens shows; they are not interpolated.

Where a renderer interpolates instead, it is given a finer texture: the light itself at several places of
every mirror, as coefficients of cubic splines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.typing import NDArray
from scipy.ndimage import spline_filter

from fpplab.core.conventions import Floats, Lattice, mirror_centres
from sim.mirror_spread import TAPS, WIDEST_CIRCLE, MirrorPointSpread, interpolation, square_to_disc_correction

Texels = NDArray[np.float32]  # a texture (rows, columns)
Part = tuple[int, int, int, int]
"""Texels (left, top, right, bottom) of a texture, the right and bottom ones excluded."""


@dataclass(frozen=True, eq=False)
class PatternTextures:
    """Textures of several patterns, or a part of them, as light is looked up in them."""

    texels: Texels  # (circles, rows, columns, patterns) of the filtered levels
    weights: Texels | None = None  # interpolation between texels (circles, STEPS + 1, TAPS)
    fill: float = 1.0  # side of a mirror with sharp edges, in texels
    origin: tuple[int, int] = (0, 0)  # (column, row) of the whole texture at which this part begins

    @property
    def nbytes(self) -> int:
        return self.texels.nbytes


@dataclass(frozen=True)
class MirrorTexture:
    """The texture of a projector."""

    size: tuple[int, int]  # (columns, rows) of mirrors
    lattice: Lattice  # how the mirrors are arranged
    blur: float  # standard deviation of the lens's point spread in mirrors, 0 or at least `MIN_BLUR`
    fill_factor: float = 1.0  # share of its square that a mirror fills
    widest: float = 0.0  # diameter of the greatest circle of confusion that will be asked for, in texels

    @property
    def exact(self) -> bool:
        """Whether mirrors have sharp edges."""
        return self.blur == 0

    @property
    def fill(self) -> float:
        return math.sqrt(self.fill_factor)

    @property
    def texels_per_column(self) -> float:
        """Texels per column of mirrors; on the diamond lattice nearest neighbours lie at 45 degrees."""
        return math.sqrt(2.0) if self.lattice is Lattice.DIAMOND else 1.0

    @property
    def places_per_mirror(self) -> int:
        """Places along each axis of a mirror at which `fine` has its light."""
        if self.exact:
            return 1
        return 2 if self.blur >= 0.45 else 3  # from that blur in mirrors, two places hold the light

    @property
    def _margin(self) -> int:
        return TAPS + sum(len(kernel) // 2 for kernel in self._filters(self.widest))

    @property
    def _layout(self) -> _Layout:
        return _texture_layout(self.size, self.lattice, self._margin)

    @property
    def affine(self) -> Floats:
        """(2, 3): projector pixels (u, v, 1) to texture (column, row); texel centres are integers."""
        return _lattice_affine(self.size, self.lattice, self._margin)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the texture, dark margin included."""
        rows, columns = self._layout.mirrors.shape
        return rows, columns

    def weights(self, circles: Sequence[float]) -> Texels | None:
        """Give the interpolation between texels for several circles of confusion."""
        # returns (L, STEPS + 1, TAPS)
        if self.exact:
            return None
        return np.stack([interpolation(self._spread(circle)).weights for circle in circles])

    def filtered(
        self, light: NDArray[np.float32], circles: Sequence[float] = (0.0,), part: Part | None = None
    ) -> list[Texels]:
        """Make the textures of mirrors with given light for several circles of confusion; dark outside."""
        # light (rows, columns); returns (rows, columns)
        filters = [self._filters(circle) for circle in circles]
        reach = max(sum(len(kernel) // 2 for kernel in of_circle) for of_circle in filters)
        sharp, inside = self._sharp(light, part, reach)
        return [_convolve_texture(sharp, of_circle)[inside] for of_circle in filters]

    def textures(
        self, levels: Sequence[Texels] | Texels, circles: Sequence[float] = (0.0,), part: Part | None = None
    ) -> PatternTextures:
        """Make the textures of several patterns, to look light up in."""
        # levels (rows, columns)
        filtered = [self.filtered(level, circles, part) for level in levels]
        texels = np.empty((len(circles), *filtered[0][0].shape, len(levels)), np.float32)
        for of_circle, patterns in zip(texels, zip(*filtered, strict=True), strict=True):
            cv2.merge(patterns, of_circle)
        return PatternTextures(texels, self.weights(circles), self.fill, part[:2] if part else (0, 0))

    def fine(self, light: NDArray[np.float32], circle: float = 0.0) -> Texels:
        """Make the texture of mirrors with given light as a renderer interpolates it; dark outside."""
        # light (rows, columns); returns (rows, columns)
        sharp, _ = self._sharp(light, None, 0)
        if self.exact:
            return sharp
        fine = self.places_per_mirror
        narrow = MirrorPointSpread(self.blur, self.fill, min(circle, WIDEST_CIRCLE))
        reach = fine * math.ceil(5 * self.blur + 1 + narrow.circle / 2)
        profile = narrow.profile(np.arange(-reach, reach + 1) / fine)
        disc = square_to_disc_correction(circle)
        placed = np.zeros((fine * sharp.shape[0], fine * sharp.shape[1]), np.float32)
        placed[::fine, ::fine] = sharp if disc is None else _convolve_texture(sharp, (disc,))
        return np.asarray(spline_filter(_convolve_texture(placed, (profile,)), order=3, output=np.float32))

    def _spread(self, circle: float) -> MirrorPointSpread:
        return MirrorPointSpread(self.blur, self.fill, min(circle, WIDEST_CIRCLE))

    def _filters(self, circle: float) -> tuple[Floats, ...]:
        """Filters to apply one after the other: along each axis where they are (n,), else in the plane."""
        if self.exact:
            return (np.ones(1),)
        along, disc = interpolation(self._spread(circle)).filter, square_to_disc_correction(circle)
        return (along,) if disc is None else (along, disc)

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


def _convolve_texture(texture: Texels, filters: Sequence[Floats]) -> Texels:
    filtered: MatLike = texture
    for kernel in filters:
        if kernel.ndim == 1 and len(kernel) > 1:
            filtered = cv2.sepFilter2D(filtered, -1, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
        elif kernel.ndim == 2:
            filtered = cv2.filter2D(filtered, -1, kernel, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(filtered, np.float32)


def _lattice_affine(size: tuple[int, int], lattice: Lattice, margin: int) -> Floats:
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
def _texture_layout(size: tuple[int, int], lattice: Lattice, margin: int) -> _Layout:
    u, v = mirror_centres(size, lattice)
    column, row = np.einsum(
        "ij,jvu->ivu", _lattice_affine(size, lattice, margin), np.stack([u, v, np.ones_like(u)])
    )
    rows, columns = np.rint(row).astype(np.intp), np.rint(column).astype(np.intp)
    shape = int(rows.max()) + margin + 1, int(columns.max()) + margin + 1
    places = np.ravel_multi_index((rows, columns), shape)
    mirrors = np.full(shape, -1, np.int32)
    np.put(mirrors, places, np.arange(places.size, dtype=np.int32))
    return _Layout(places, mirrors)
