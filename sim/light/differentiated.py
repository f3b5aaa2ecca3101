"""Computed light with its derivatives, for an item in one pose."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from fpplab.core.conventions import Floats, PixelIndices
from fpplab.patterns.fringes import Pattern
from sim.light.basis import PatternLevels
from sim.light.cache import ByteLimitedCache, table_digest
from sim.light.lamps import RoomLightAt
from sim.light.mirrors import Mirrors
from sim.light.plane import computed_motion
from sim.light.table import BATCH_PATTERNS, LightTable, MotionTable
from sim.scene import RenderScene, SubpixelView
from sim.texture import MirrorTexture, PatternTextures


@dataclass(frozen=True, eq=False)
class DifferentiatedLight:
    """Light of a scene that is computed."""

    scene: RenderScene  # one flat, matt item
    views: list[SubpixelView]  # points of the pixels and of the lens
    mirrors: Mirrors  # of the projector
    texture: MirrorTexture  # how mirrors become a texture
    room: RoomLightAt  # gives the light that is not the projector's on what pixels see, see `RoomLight.on`
    falloff: PatternLevels | None  # of the camera's lens, (height, width)
    motions: ByteLimitedCache[MotionTable]  # tables of last time
    behind: Callable[[Pattern, PixelIndices | None], PatternLevels] | None = None  # (height, width)
    # displaces samples by errors of a board's points
    erring: Callable[[Callable[[], LightTable]], LightTable] | None = None

    def at(self, patterns: tuple[Pattern, ...], pixels: PixelIndices) -> tuple[PatternLevels, PatternLevels]:
        """Compute what `Light.irradiance_at` gives, with derivatives by the places that the pixels see."""
        # returns irradiance (n, P), slopes (n, P, 4) mm
        table = self._trace_motion(pixels)
        terms = np.concatenate([table.look_up(textures) for _, textures in self._batches(table, patterns)])
        room, per_px = self.room(pixels), self.texture.affine[:, :2].astype(np.float32)
        irradiance = terms[..., 0] + room * table.table.albedo[0]
        if self.behind is not None:
            irradiance += np.stack([self.behind(pattern, pixels) for pattern in patterns])
        slopes = np.concatenate(
            [terms[..., 1:3] + np.asarray(room)[..., None] * table.albedo_slopes, terms[..., 3:5] @ per_px],
            axis=-1,
        )
        if self.falloff is not None:
            irradiance *= self.falloff[pixels]
            slopes *= self.falloff[pixels][:, None]
        return irradiance, slopes

    def displaced(self, patterns: tuple[Pattern, ...], moves: Floats) -> Iterator[PatternLevels]:
        """Compute the irradiance of an item that is displaced under every pattern, to first order."""
        # moves (n, 3) mm; returns (height, width)
        table, room = self._trace_motion(None), self.room(None)
        if self.erring is not None:
            exact = table.table
            table = replace(table, table=self.erring(lambda: exact))
        for few, textures in self._batches(table, patterns):
            for pattern, item in zip(patterns[few], table.displaced(textures, moves[few], room), strict=True):
                picture = item if self.behind is None else item + self.behind(pattern, None)
                yield picture if self.falloff is None else picture * self.falloff

    def _trace_motion(self, pixels: PixelIndices | None) -> MotionTable:
        """Trace the scene at some pixels; a table of the whole image has the key of the plain table."""
        key = table_digest(self.scene, self.views, *(() if pixels is None else (pixels,)))
        return self.motions.get(key, lambda: computed_motion(self.scene, self.views, pixels))

    def _batches(
        self, table: MotionTable, patterns: tuple[Pattern, ...]
    ) -> Iterator[tuple[slice, PatternTextures]]:
        part = table.table.part(self.texture.shape)
        for first in range(0, len(patterns), BATCH_PATTERNS):
            few = slice(first, first + BATCH_PATTERNS)
            yield few, self.mirrors.textures(patterns[few], self.texture, self.scene.lamp.circles, part)
