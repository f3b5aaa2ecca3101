"""From a pattern on show to the irradiance that the camera sees, by the cheapest way that is right.

Light is linear: a picture under a sum of patterns is the sum of the pictures. Three ways to one result:

`transport`  Direct light only. The projector paints its own coordinates on the scene once; each sub-pixel
             then knows where on the projector it looks and how brightly white would be there, and any pattern
             is a look-up in its texture: `I = mean_k shade_k * pattern(s_k, t_k)`.
`linear`     The loaded patterns' light levels lie, but for rounding, in a space of few dimensions: for F
             fringe sets a linear projector needs 1 + 2F, a bent response two more for each harmonic. One
             channel of one render for each dimension, three in a render; patterns are recombined from them.
`reference`  One render for every pattern: slow, and what the others are held against.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from fpplab.patterns import Pattern
from sim.items import build_scene
from sim.scene import Effort, Scene
from sim.worker import Blender
from sim.world import World

Picture = NDArray[np.float32]

KEEP_BYTES = 1 << 29
START_S, PATHS_PER_S = 60.0, 5e4


@dataclass(frozen=True)
class Setup:
    """All that moves on the bench: the item and its pose, and the stage's position in mm."""

    item: str = "nothing"
    pose: int = 0
    stage_mm: float = 0.0


@dataclass(frozen=True, eq=False)
class Show:
    """Pattern `index` of the loaded `patterns` is on."""

    patterns: tuple[Pattern, ...]
    index: int

    @property
    def pattern(self) -> Pattern:
        return self.patterns[self.index]


class Kept:
    """Pictures from before; when they are more than `KEEP_BYTES` the longest unused go."""

    def __init__(self) -> None:
        self._pictures: OrderedDict[tuple[object, ...], Picture] = OrderedDict()

    def get(self, key: tuple[object, ...], make: Callable[[], Picture]) -> Picture:
        """The picture of that key, made if it is not there."""
        if key not in self._pictures:
            self._pictures[key] = make()
        self._pictures.move_to_end(key)
        while len(self._pictures) > 1 and sum(p.nbytes for p in self._pictures.values()) > KEEP_BYTES:
            self._pictures.popitem(last=False)
        return self._pictures[key]

    def take(self, other: Kept, wanted: Callable[[tuple[object, ...]], bool]) -> None:
        """Share the wanted ones of another."""
        self._pictures.update({key: p for key, p in other._pictures.items() if wanted(key)})

    def clear(self) -> None:
        """Let go of all."""
        self._pictures.clear()


@dataclass(frozen=True, eq=False)
class Basis:
    """Light levels of patterns as sums: `level_n = Σ_c weights[n, c] channels[c]`.

    weights: (patterns, channels). channels: (channels, rows, columns) of mirrors, within [0, 1].
    """

    weights: NDArray[np.float64]
    channels: Picture


class Light:
    """The light of one world. Pictures are kept while nothing moves."""

    def __init__(self, world: World, blender: Blender) -> None:
        self._world, self._blender = world, blender
        self._texture = world.projector.texture()
        self._kept = Kept()
        self._textures = Kept()
        self._basis: tuple[tuple[Pattern, ...], Basis] | None = None
        self._scene: tuple[Setup, Scene] | None = None

    @property
    def path(self) -> str:
        """The way that serves this world."""
        chosen = self._world.render.path
        if chosen != "auto":
            return chosen
        return "linear" if self._world.render.bounces else "transport"

    def irradiance(self, setup: Setup, show: Show | None) -> Picture:
        """What the camera sees (height, width) float32, 1 for white; `show` None: the lamp is off.

        Raises `DeviceError` from the Blender process, `ConfigError` for an item that cannot be made.
        """
        width, height = self._world.camera.size
        if setup.item == "nothing" or (show is None and not self._world.ambient):
            return np.zeros((height, width), np.float32)
        picture = np.zeros((height, width), np.float32) if show is None else self._projected(setup, show)
        if self._world.ambient:
            reflectance = self.transport(setup)[..., 3].mean(axis=0)
            picture += np.float32(self._world.ambient) * reflectance
        return picture

    def transport(self, setup: Setup) -> Picture:
        """For every sub-pixel (sub-pixels, height, width, 4): texture column and row, shade, reflectance."""
        return self._kept.get((setup, None), lambda: self._painted(setup))

    def inherit(self, other: Light) -> None:
        """Take over the samples of another world that differs in nothing that they depend on."""
        if _optical(self._world) == _optical(other._world):
            self._kept.take(other._kept, lambda key: key[1] is None)

    def forget(self) -> None:
        """Let go of every picture."""
        self._kept.clear()
        self._textures.clear()

    def _projected(self, setup: Setup, show: Show) -> Picture:
        if self.path == "transport":
            texture = self._textures.get(
                (show.pattern,), lambda: self._texture.spread(self._levels(show.pattern))
            )
            return look_up(texture, self.transport(setup), self._texture.exact)
        if self.path == "linear":
            basis = self._basis_of(show.patterns)
            pictures = self._kept.get((setup, basis), lambda: self._rendered(setup, basis.channels))
            weights = basis.weights[show.index].astype(np.float32)
            return np.asarray(np.einsum("c,cvu->vu", weights, pictures), np.float32)
        picture: Picture = self._rendered(setup, self._levels(show.pattern)[None])[0]
        return picture

    def _levels(self, pattern: Pattern) -> Picture:
        """Light of every mirror, relative to the brightest: the response to the grey levels."""
        response = self._world.projector.response
        table = response.a * np.linspace(0, 1, 256) ** response.g + response.b
        return table.astype(np.float32)[pattern.image]

    def _basis_of(self, patterns: tuple[Pattern, ...]) -> Basis:
        if self._basis is None or self._basis[0] is not patterns:
            response = self._world.projector.response
            rounding = response.a * max(response.g, 1.0) / np.sqrt(12)
            allowed = rounding / (2 ** min(p.bit_depth for p in patterns) - 1)
            basis = span(np.stack([self._levels(p) for p in patterns]), allowed)
            self._basis = (patterns, basis)
        return self._basis[1]

    def _painted(self, setup: Setup) -> Picture:
        samples = self._render(setup, None, Effort())
        shade = samples[..., 2:3]
        lit = np.where(shade > 0, shade, np.inf)
        samples[..., :2] /= lit
        return samples

    def _rendered(self, setup: Setup, channels: Picture) -> Picture:
        """Pictures (channels, height, width) under mirrors (channels, rows, columns)."""
        render = self._world.render
        effort = Effort(render.samples, render.bounces, self._world.seed)
        pictures = []
        for start in range(0, len(channels), 3):
            group = [self._texture.spread(channel) for channel in channels[start : start + 3]]
            texture = np.stack(group + [np.zeros_like(group[0])] * (3 - len(group)), axis=-1)
            rendered = self._render(setup, texture, effort).mean(axis=0)
            pictures += [np.ascontiguousarray(rendered[..., c]) for c in range(len(group))]
        return np.stack(pictures)

    def _render(self, setup: Setup, texture: Picture | None, effort: Effort) -> Picture:
        if self._scene is None or self._scene[0] != setup:
            self._scene = (setup, build_scene(self._world, setup.item, setup.pose, setup.stage_mm))
        shifts = self._world.render.shifts
        width, height = self._world.camera.size
        paths = width * height * len(shifts) * effort.samples * (1 + effort.bounces)
        return self._blender.render(self._scene[1], texture, shifts, effort, START_S + paths / PATHS_PER_S)


def _optical(world: World) -> dict[str, Any]:
    """All of a world that direct light's samples depend on."""
    excluded: dict[str, Any] = {
        "seed": True,
        "ambient": True,
        "camera": {"sensor"},
        "projector": {"response"},
        "stage": {"travel_mm"},
        "render": {"path", "samples", "bounces"},
    }
    return world.model_dump(exclude=excluded)


def span(levels: Picture, allowed: float) -> Basis:
    """The smallest basis from which every pattern follows within `allowed` RMS.

    levels: (patterns, rows, columns) in [0, 1]. The first channel is white; the others are principal
    components, moved and scaled into [0, 1] so that they can be projected.
    """
    n, shape = len(levels), levels.shape[1:]
    flat = levels.reshape(n, -1)
    mean = flat.mean(axis=1, dtype=np.float64)
    centred = flat - mean[:, None].astype(np.float32)
    energy, vectors = np.linalg.eigh(
        centred.astype(np.float64) @ centred.T.astype(np.float64) / flat.shape[1]
    )
    rank = next(r for r in range(n + 1) if _residual(energy, vectors, n - r) <= allowed)
    loading = vectors[:, n - rank :]
    components = loading.T.astype(np.float32) @ centred
    low, high = components.min(axis=1), components.max(axis=1)
    scaled = (components - low[:, None]) / (high - low)[:, None]
    weights = np.column_stack([mean + loading @ low, loading * (high - low)])
    channels = np.concatenate([np.ones((1, flat.shape[1]), np.float32), scaled])
    return Basis(weights, channels.reshape(-1, *shape))


def _residual(energy: NDArray[np.float64], vectors: NDArray[np.float64], left: int) -> float:
    """Greatest RMS over patterns of what the `left` weakest components hold."""
    if left == 0:
        return 0.0
    shares = (vectors[:, :left] ** 2) @ np.maximum(energy[:left], 0.0)
    return float(np.sqrt(shares.max()))


def look_up(texture: Picture, samples: Picture, exact: bool) -> Picture:
    """The picture (height, width) of a texture through samples (sub-pixels, height, width, 4)."""
    _, height, width, _ = samples.shape
    out = np.zeros((height, width), np.float32)
    flat = samples.reshape(len(samples), height * width, 4)
    (_nearest if exact else _interpolated)(texture, flat, out.ravel())
    return out


@numba.njit(parallel=True, cache=True)
def _interpolated(texture: Picture, samples: Picture, out: Picture) -> None:
    rows, columns = texture.shape
    share = np.float32(1.0 / samples.shape[0])
    for p in numba.prange(samples.shape[1]):
        total = np.float32(0.0)
        for k in range(samples.shape[0]):
            shade = samples[k, p, 2]
            x, y = samples[k, p, 0], samples[k, p, 1]
            if shade > 0 and 0 <= x < columns - 1 and 0 <= y < rows - 1:
                i, j = int(x), int(y)
                fx, fy = x - np.float32(i), y - np.float32(j)
                top = texture[j, i] + fx * (texture[j, i + 1] - texture[j, i])
                bottom = texture[j + 1, i] + fx * (texture[j + 1, i + 1] - texture[j + 1, i])
                total += shade * (top + fy * (bottom - top))
        out[p] = total * share


@numba.njit(parallel=True, cache=True)
def _nearest(texture: Picture, samples: Picture, out: Picture) -> None:
    rows, columns = texture.shape
    share = np.float32(1.0 / samples.shape[0])
    for p in numba.prange(samples.shape[1]):
        total = np.float32(0.0)
        for k in range(samples.shape[0]):
            shade = samples[k, p, 2]
            i, j = np.floor(samples[k, p, 0] + np.float32(0.5)), np.floor(samples[k, p, 1] + np.float32(0.5))
            if shade > 0 and 0 <= i < columns and 0 <= j < rows:
                total += shade * texture[int(j), int(i)]
        out[p] = total * share
