"""Direct light on the surroundings and on standing items, behind the mounted item and in its shadow.

They stand still, so their table is traced once for each pose of the item. What light they throw
on the item is left out, as all light by way of other surfaces is on the path `transport`.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fpplab.core.conventions import PixelIndices
from fpplab.patterns.fringes import Pattern
from sim.build import NOTHING, SceneState, build_background
from sim.light.basis import PatternLevels
from sim.light.cache import ByteLimitedCache, table_digest
from sim.light.lamps import RoomLightAt
from sim.light.lens import lens_views
from sim.light.mirrors import Mirrors
from sim.light.solid import Bodies, traced
from sim.light.table import Irradiance, LightTable
from sim.scene import RenderScene, SubpixelView, Surface
from sim.texture import MirrorTexture
from sim.world import World


class Background:
    """The light of the surroundings of one world."""

    def __init__(self, world: World, surfaces: tuple[Surface, ...]) -> None:
        self._world, self._surfaces = world, surfaces
        # Two by two points of every pixel are few: surfaces far behind the item are not sharp.
        self._views = lens_views(2, world.camera.aperture_mm)
        self._tables: ByteLimitedCache[LightTable] = ByteLimitedCache()
        self._scene: tuple[SceneState, RenderScene, MirrorTexture] | None = None

    def pictures(
        self, setup: SceneState, light: Sequence[PatternLevels], pixels: PixelIndices | None = None
    ) -> PatternLevels:
        """Compute the irradiance that the camera sees of the surroundings, without vignetting."""
        # light (rows, columns); returns (n, height, width)
        _, scene, texture = self._build_scene(setup)
        table = self._table(setup, pixels)
        shown = table.look_up(texture.textures(light, scene.lamp.circles, table.part(texture.shape)))
        return shown if pixels is None else shown[:, 0]

    def albedo(self, setup: SceneState, pixels: PixelIndices | None = None) -> Irradiance:
        """Give the reflectance of the surroundings that the camera sees, 0 where the item hides them."""
        # returns (height, width)
        reflectance = self._table(setup, pixels).albedo
        return reflectance if pixels is None else reflectance[0]

    def scene(self, setup: SceneState) -> RenderScene:
        """Give the surroundings together with the mounted item."""
        return self._build_scene(setup)[1]

    def irradiance(
        self,
        setup: SceneState,
        light: Sequence[PatternLevels],
        room: Irradiance | np.float32,
        pixels: PixelIndices | None,
    ) -> PatternLevels:
        """Compute the irradiance of the surroundings, that of other light than the projector's included."""
        # light (rows, columns); returns (n, P)
        total = self.pictures(setup, light, pixels)
        total += room * self.albedo(setup, pixels)
        return total

    def behind(
        self, setup: SceneState, mirrors: Mirrors, room: RoomLightAt
    ) -> Callable[[Pattern, PixelIndices | None], PatternLevels]:
        """Give the light of the surroundings as a function of the pattern, with other light."""
        # returns (P,)

        def light(pattern: Pattern, pixels: PixelIndices | None) -> PatternLevels:
            levels = [mirrors.level(pattern)]
            irradiance: PatternLevels = self.irradiance(setup, levels, room(pixels), pixels)[0]
            return irradiance

        return light

    def _table(self, setup: SceneState, pixels: PixelIndices | None) -> LightTable:
        _, scene, _ = self._build_scene(setup)
        shown = len(scene.surfaces) - (setup.item != NOTHING)  # the item's own light is added elsewhere
        if pixels is None:
            return self._tables.get(
                table_digest(scene, self._views), lambda: _trace_window(scene, self._views, shown)
            )
        return self._tables.get(
            table_digest(scene, self._views, pixels), lambda: traced(scene, self._views, pixels, shown)
        )

    def _build_scene(self, setup: SceneState) -> tuple[SceneState, RenderScene, MirrorTexture]:
        at_rest = replace(setup, vibration_mm=(0.0, 0.0, 0.0))
        if self._scene is None or self._scene[0] != at_rest:
            self._scene = (at_rest, *build_background(self._world, at_rest, self._surfaces))
        return self._scene


def _trace_window(scene: RenderScene, views: list[SubpixelView], shown: int) -> LightTable:
    """Trace all pixels of the scene's window, some rows at a time; the light of the first surfaces shown."""
    (width, height), (left, top, right, bottom) = scene.camera.size, scene.window
    samples = np.zeros((len(views), bottom - top, right - left, 4), np.float32)
    albedo = np.zeros((height, width), np.float32)
    table = LightTable(samples, albedo, (left, top))
    if right <= left or bottom <= top:  # in an empty window nothing is seen
        return table
    bodies, step = Bodies(scene, shown), max(1, (1 << 18) // (right - left))  # rows of some 260,000 pixels
    for first in range(top, bottom, step):
        rows, columns = np.mgrid[first : min(first + step, bottom), left:right]
        band = bodies.traced(views, (rows.ravel(), columns.ravel()))
        samples[:, rows[:, 0] - top] = band.samples.reshape(len(views), *rows.shape, 4)
        albedo[rows, columns] = band.albedo.reshape(rows.shape)
    return table
