"""Direct light as a table: for every sample of a pixel, its place on the projector and its irradiance.

`I = mean_k shade_k * texture(column_k, row_k, circle_k)` for any pattern, brightness or response.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from numpy.typing import NDArray

from fpplab.core.compiled import kernel, kernel_part
from fpplab.core.conventions import Floats, PixelIndices
from fpplab.core.geometry import RigidTransform, distort
from sim.light.look_up import WINDOW, interpolated_light, sharp_light
from sim.scene import ALBEDO, DIRECT, RenderScene, X, Y, Z
from sim.texture import Part, PatternTextures

Irradiance = NDArray[np.float32]  # arrays of a table, or pictures looked up in it
RoomLevel = Irradiance | np.float32  # light of the room on all pixels, the same on each where it is one

BATCH_PATTERNS = 40  # patterns that are looked up at once, at most (chosen)
BATCH_PIXELS = 1 << 15  # whose derivatives of the light are held at once (chosen)
MIN_WHITE = np.float32(0.02)
"""Share of full light, at the edge of the projector's outermost mirrors, below which it is not divided by."""


@dataclass(frozen=True, eq=False)
class LightTable:
    """Where K samples of every pixel lie on the projector, and how much white light falls there."""

    samples: Irradiance  # (K, h, w, 4)
    albedo: Irradiance  # reflectance (height, width) of the whole image, averaged over samples
    corner: tuple[int, int] = (0, 0)  # (left, top) in px of the part of the image that has samples

    @property
    def nbytes(self) -> int:
        return self.samples.nbytes + self.albedo.nbytes

    @cached_property
    def reach(self) -> tuple[Floats, Floats]:
        """Least and greatest (column, row) of the texture at which illuminated samples lie."""
        return _sample_extent(self.samples.reshape(-1, 4))

    @classmethod
    def of(cls, rendered: Irradiance, scene: RenderScene) -> LightTable:
        """Make the table from a survey of a scene under uniform white light."""
        # rendered (K, height, width, CHANNELS)
        lamp, (left, top, right, bottom) = scene.lamp, scene.window
        survey = rendered[:, top:bottom, left:right]
        views, height, width, channels = survey.shape
        samples = np.empty((views, height, width, 4), np.float32)
        T = RigidTransform(lamp.T_camera_projector[:3, :3], lamp.T_camera_projector[:3, 3]).inverse()
        _locate_in_texture(
            survey.reshape(-1, channels),
            T.matrix[:3],
            lamp.optics.distortion,
            lamp.affine @ lamp.optics.matrix,
            lamp.texels_per_slope * lamp.aperture.diameter_mm,
            1.0 / lamp.aperture.focus_mm,
            np.array(lamp.circles, np.float64) ** 2,
            samples.reshape(-1, 4),
        )
        albedo = np.zeros(rendered.shape[1:3], np.float32)
        for view in rendered:
            albedo += view[..., ALBEDO]
        return cls(samples, albedo / np.float32(views), (left, top))

    def at(self, pixels: PixelIndices) -> LightTable:
        (left, top), (height, width) = self.corner, self.samples.shape[1:3]
        row, column = pixels[0] - top, pixels[1] - left
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        samples = np.zeros((len(self.samples), 1, len(row), 4), np.float32)
        samples[:, 0, inside] = self.samples[:, row[inside], column[inside]]
        return LightTable(samples, self.albedo[pixels][None])

    def part(self, shape: tuple[int, int]) -> Part:
        """Find the region of a texture that the samples need, interpolation included."""
        # shape (rows, columns); returns (left, top, right, bottom)
        size = np.array(shape[::-1])
        low = np.clip(np.rint(self.reach[0]) - WINDOW // 2, 0, size - WINDOW)
        high = np.clip(np.rint(self.reach[1]) + WINDOW // 2 + 1, low + WINDOW, size)
        (left, top), (right, bottom) = low.astype(int).tolist(), high.astype(int).tolist()
        return left, top, right, bottom

    def look_up(self, textures: PatternTextures) -> Irradiance:
        # returns (patterns, height, width)
        views, h, w, _ = self.samples.shape
        light = np.empty((textures.texels.shape[-1], h * w), np.float32)
        flat = self.samples.reshape(views, h * w, 4)
        x, y = map(np.float32, textures.origin)
        if textures.weights is None:
            sharp_light(textures.texels[0], flat, x, y, np.float32(textures.fill), light)
        else:
            interpolated_light(textures.texels, textures.weights, flat, None, 0, x, y, light[..., None])
        pictures = light.reshape(len(light), h, w)
        if (h, w) == self.albedo.shape:
            return pictures
        left, top = self.corner
        whole = np.zeros((len(pictures), *self.albedo.shape), np.float32)
        whole[:, top : top + h, left : left + w] = pictures
        return whole

    def divided_by(self, white: PatternTextures) -> LightTable:
        """Convert a table of light from white mirrors to one of uniform white light."""
        samples = self.samples.copy()
        each = samples.reshape(1, 1, -1, 4)
        shade = each[0, 0, :, 3]
        # the shade already contains the white mirrors once; looked up it contains them twice
        again = LightTable(each, each[0, ..., 0]).look_up(white)[0, 0]
        lit = again > MIN_WHITE * shade
        shade[:] = np.divide(shade**2, again, out=np.zeros_like(again), where=lit)
        return LightTable(samples, self.albedo, self.corner)


_distort = numba.njit(inline="always")(distort)


@kernel(parallel=True, error_model="numpy")
def _locate_in_texture(
    rendered: Irradiance,
    T_projector_camera: Floats,
    distortion: Floats,
    to_texel: Floats,
    circle_scale: float,
    inverse_focus: float,
    squares: Floats,
    out: Irradiance,
) -> None:
    """Project points with the lens model of `fpplab.core.geometry`, in float64 for sub-texel precision."""
    R, t = T_projector_camera[:, :3], T_projector_camera[:, 3]
    for i in numba.prange(len(rendered)):
        out[i] = 0
        px, py, pz = np.float64(rendered[i, X]), np.float64(rendered[i, Y]), np.float64(rendered[i, Z])
        if rendered[i, DIRECT] <= 0 or pz == 0:
            continue
        z = R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz + t[2]
        x = (R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz + t[0]) / z
        y = (R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz + t[1]) / z
        xd, yd, _, _, _ = _distort(x, y, distortion)
        out[i, 0] = to_texel[0, 0] * xd + to_texel[0, 1] * yd + to_texel[0, 2]
        out[i, 1] = to_texel[1, 0] * xd + to_texel[1, 1] * yd + to_texel[1, 2]
        out[i, 2] = circle_level(z, circle_scale, inverse_focus, squares)
        out[i, 3] = rendered[i, DIRECT]


@kernel_part()
def circle_level(depth: float, circle_scale: float, inverse_focus: float, squares: Floats) -> float:
    """Interpolate a depth's circle of confusion among those with textures, by its square."""
    # squares (L,)
    if len(squares) == 1:
        return 0.0
    circle = circle_scale * (1.0 / depth - inverse_focus)
    square = circle * circle
    level = 0
    while level < len(squares) - 2 and square > squares[level + 1]:
        level += 1
    share = (square - squares[level]) / (squares[level + 1] - squares[level])
    return float(level + min(max(share, 0.0), 1.0))


@kernel()
def _sample_extent(samples: Irradiance) -> tuple[Floats, Floats]:
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for sample in samples:
        if sample[3] > 0:
            for axis in range(2):
                low[axis] = min(low[axis], sample[axis])
                high[axis] = max(high[axis], sample[axis])
    return low, high


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

    def look_up(self, textures: PatternTextures, pixels: slice = slice(None)) -> Irradiance:
        # returns (n, P, 5) mm, of a range of the pixels
        assert textures.weights is not None
        views, h, w, _ = self.table.samples.shape
        first, end, _ = pixels.indices(h * w)
        terms = np.empty((textures.texels.shape[-1], end - first, 5), np.float32)
        x, y = map(np.float32, textures.origin)
        flat = self.table.samples.reshape(views, h * w, 4)
        interpolated_light(textures.texels, textures.weights, flat, self.slopes, first, x, y, terms)
        return terms

    def displaced(self, textures: PatternTextures, moves: Floats, room: RoomLevel) -> Irradiance:
        """Compute the light on the displaced item to first order, other light included."""
        # moves (n, 3) mm; room (height, width); returns (n, height, width)
        _, h, w, _ = self.table.samples.shape
        left, top = self.table.corner
        height, width = self.table.albedo.shape
        light = np.empty((len(moves), h * w), np.float32)
        even = np.broadcast_to(np.asarray(room, np.float32), self.table.albedo.shape)
        albedo, elsewhere = (
            values[top : top + h, left : left + w].ravel() for values in (self.table.albedo, even)
        )
        for first in range(0, h * w, BATCH_PIXELS):
            few = slice(first, first + BATCH_PIXELS)
            per_mm, other = self.motion[few], (elsewhere[few], albedo[few], self.albedo_slopes[few])
            _displace(self.look_up(textures, few), per_mm, moves, *other, light[:, few])
        pictures = np.zeros((len(moves), height, width), np.float32)
        pictures[:, top : top + h, left : left + w] = light.reshape(-1, h, w)
        return pictures


@kernel(parallel=True)
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
