"""From a pattern on show to the irradiance that the camera sees, by the cheapest correct light path.

Light is linear: a picture under a sum of patterns is the sum of the pictures. Three ways to the same result:

`transport`  Direct light only. Blender surveys the scene once: for every sample of a pixel, the point that is
             seen and the irradiance there under white; any pattern is then a look-up in its texture.
`linear`     Apart from quantisation the loaded patterns' light levels lie in a space of few dimensions: for F
             fringe sets a linear projector needs 1 + 2F, a nonlinear response two more for each harmonic.
             Every dimension is one colour channel of a render, three to a render; pictures of patterns are
             linear combinations of them. The residual of quantisation is added as direct light, from the
             table that the first render gives.
`reference`  One render for every pattern: slow; what the other two are compared with.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from fpplab.core.conventions import Floats, PixelIndices
from fpplab.patterns.fringes import Pattern
from sim.build import NOTHING, SceneState, build_scene
from sim.items import standing_surfaces
from sim.light.background import Background
from sim.light.basis import Basis, PatternLevels
from sim.light.cache import ByteLimitedCache, TableCache, table_digest
from sim.light.differentiated import DifferentiatedLight
from sim.light.lamps import RoomLight, point_lamps
from sim.light.lens import lens_views, vignetting
from sim.light.mirrors import Mirrors, MirrorStates
from sim.light.plane import can_compute, computed, computed_motion
from sim.light.point_errors import displaced_by_errors, point_error_sizes
from sim.light.solid import can_trace, traced
from sim.light.table import BATCH_PATTERNS, LightTable, MotionTable
from sim.scene import COLOURS, PatternRender, RenderScene, RenderSettings, SubpixelView
from sim.sheet import surroundings_surfaces
from sim.texture import MirrorTexture
from sim.worker import Blender
from sim.world import World

TABLE_BYTES, CACHE_BYTES, POSE_BYTES = 3 << 27, 1 << 27, 1 << 25
"""Size of the tables that are kept, of the pictures, and of what is of use for a pose at a time.

The tables are those of six poses at 1368 x 912, whose images a matching compares again and again."""
SETUPS_OF_A_FRAME = 4  # whose pictures make that of a displaced item, see `sim.fluctuation`
START_S, PATHS_PER_S = 60.0, 5e4
"""Time limit of a render: a fixed part, and the light paths that any computer traces in a second."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class ShownPattern:
    """Which of the loaded patterns is on show."""

    patterns: tuple[Pattern, ...]  # the loaded patterns
    index: int  # of the pattern on show

    @property
    def pattern(self) -> Pattern:
        """The pattern on show."""
        return self.patterns[self.index]


@dataclass(frozen=True, eq=False)
class Rendered:
    """Pictures of a basis, and the table of direct light from the same renders."""

    pictures: PatternLevels  # (channels, height, width)
    table: LightTable  # of direct light

    @property
    def nbytes(self) -> int:
        return self.pictures.nbytes + self.table.nbytes


class Light:
    """The light of one world. Pictures are kept while nothing moves, tables of direct light also on disk."""

    def __init__(
        self, world: World, blender: Blender, cache: TableCache | None = None, analytic: bool = False
    ) -> None:
        self._world, self._blender, self._analytic = world, blender, analytic
        self._cache = cache if cache or not world.render.cache else TableCache()
        self._projector = Mirrors(world.projector)
        self._tables: ByteLimitedCache[LightTable] = ByteLimitedCache(TABLE_BYTES)
        self._motions: ByteLimitedCache[MotionTable] = ByteLimitedCache(POSE_BYTES)
        self._displaced: tuple[str, LightTable] | None = None
        self._erring: ByteLimitedCache[LightTable] = ByteLimitedCache(POSE_BYTES)
        self._pictures: ByteLimitedCache[PatternLevels] = ByteLimitedCache(CACHE_BYTES)
        self._bases: ByteLimitedCache[Rendered] = ByteLimitedCache(1 << 30)
        self._albedos: ByteLimitedCache[PatternLevels] = ByteLimitedCache(POSE_BYTES)
        self._others: ByteLimitedCache[PatternLevels] = ByteLimitedCache(POSE_BYTES)  # of the room's light
        self._lamp_shares: ByteLimitedCache[PatternLevels] = ByteLimitedCache(POSE_BYTES)
        self._scene: tuple[SceneState, RenderScene, MirrorTexture] | None = None
        self._around = (*standing_surfaces(world), *surroundings_surfaces(world))
        # On the path `transport` the mounted item and all that stands still have tables of their own.
        apart = self._around if world.path == "transport" else ()
        self._background = Background(world, apart) if apart else None
        self._falloff, self._room = vignetting(world), RoomLight(world)
        if world.render.path == "auto" and world.indirect:
            _log.warning(
                "the twin takes the light path '%s', because there is %s", world.path, world.indirect
            )

    def irradiance(
        self, setup: SceneState, show: ShownPattern | None, row_weights: Floats | None = None
    ) -> PatternLevels:
        # row_weights (bits, height); returns (height, width)
        width, height = self._world.camera.size
        if self._is_empty(setup) or (show is None and not self._world.has_room_light):
            return np.zeros((height, width), np.float32)
        picture = np.zeros((height, width), np.float32)
        if show is not None:
            picture += self._project_pattern(setup, show, row_weights)
        if self._world.has_room_light:
            picture += self._others.get(
                setup, lambda: self._room.on(self._in_view(setup)) * self._albedo(setup)
            )
        if self._falloff is not None:
            picture *= self._falloff
        return picture

    def lamp_share(self, setup: SceneState, pixels: PixelIndices | None = None) -> PatternLevels:
        """Compute the share of lamps in the room's light on what pixels see; pixels: None for all."""
        # returns (P,), or (height, width)
        width, height = self._world.camera.size
        if not point_lamps(self._world) or self._is_empty(setup):
            return np.zeros((height, width) if pixels is None else len(pixels[0]), np.float32)

        def make() -> PatternLevels:
            room = np.asarray(self._room.on(self._in_view(setup), pixels), np.float32)
            return 1 - np.float32(self._world.ambient) / np.maximum(room, np.finfo(np.float32).tiny)

        return make() if pixels is not None else self._lamp_shares.get(setup, make)

    def _is_empty(self, setup: SceneState) -> bool:
        return setup.item == NOTHING and not self._around

    def irradiance_at(
        self, setup: SceneState, patterns: tuple[Pattern, ...], pixels: PixelIndices
    ) -> PatternLevels:
        """Compute what `irradiance` gives at some pixels only, under several patterns."""
        # What is computed, and matt bodies, are traced for these pixels alone; a rendered table is looked up.
        # returns (n, P)
        if self._world.path != "transport":
            return np.stack(
                [self.irradiance(setup, ShownPattern(patterns, n))[pixels] for n in range(len(patterns))]
            )
        (_, scene, texture), table = self._built(setup), self._table_at(setup, pixels)
        circles, part = scene.lamp.circles, table.part(texture.shape)
        irradiance: PatternLevels = np.concatenate(
            [
                table.look_up(
                    self._projector.textures(patterns[n : n + BATCH_PATTERNS], texture, circles, part)
                )[:, 0]
                for n in range(0, len(patterns), BATCH_PATTERNS)
            ]
        )
        room = self._room.on(self._in_view(setup), pixels)
        irradiance += room * table.albedo[0]
        if self._background is not None:
            levels = [self._projector.level(pattern) for pattern in patterns]
            irradiance += self._background.irradiance(setup, levels, room, pixels)
        return irradiance if self._falloff is None else irradiance * self._falloff[pixels]

    def differentiated(self, setup: SceneState) -> DifferentiatedLight | None:
        _, scene, texture = self._built(setup)
        if self._world.path != "transport" or not self.computes(setup) or texture.exact:
            return None
        views, room = self._views(setup), partial(self._room.on, self._in_view(setup))
        behind = None if self._background is None else self._background.behind(setup, self._projector, room)
        changed = partial(self._with_point_errors, setup) if self._has_point_errors(setup) else None
        return DifferentiatedLight(
            scene, views, self._projector, texture, room, self._falloff, self._motions, behind, changed
        )

    def _table_at(self, setup: SceneState, pixels: PixelIndices) -> LightTable:
        (_, scene, _), views = self._built(setup), self._views(setup)
        if self.computes(setup):
            make = partial(computed, scene, views, spots=True, pixels=pixels)
        elif can_trace(scene):
            make = partial(traced, scene, views, pixels)
        else:
            return self.table(setup).at(pixels)
        return self._tables.get(table_digest(scene, views, pixels), make)

    def computes(self, setup: SceneState) -> bool:
        """Return whether the item's light is computed, without a render."""
        return self._analytic and can_compute(self._built(setup)[1])

    def table(self, setup: SceneState) -> LightTable:
        """Get the direct light on all that is in view, from memory, from disk, or rendered."""
        if not self._has_point_errors(setup):
            return self._exact_table(setup)
        return self._with_point_errors(setup, lambda: self._exact_table(setup))

    def _has_point_errors(self, setup: SceneState) -> bool:
        has_board = setup.error_draw is not None and setup.item in self._world.items
        return has_board and point_error_sizes(self._world) is not None

    def _with_point_errors(self, setup: SceneState, exact: Callable[[], LightTable]) -> LightTable:
        to_texel = self._built(setup)[2].affine[:, :2]
        return self._erring.get(setup, lambda: displaced_by_errors(self._world, setup, exact(), to_texel))

    def _exact_table(self, setup: SceneState) -> LightTable:
        _, scene, _ = self._built(setup)
        key = table_digest(scene, self._views(setup))
        if any(setup.vibration_mm):  # the next frame has another
            if self._displaced is None or self._displaced[0] != key:
                self._displaced = (key, self._load_or_make(setup, key))
            return self._displaced[1]
        if key in self._motions:  # the same table, with derivatives
            return self._motions.get(key, lambda: computed_motion(scene, self._views(setup))).table
        return self._tables.get(key, lambda: self._load_or_make(setup, key))

    def inherit(self, other_light: Light) -> None:
        """Take over the tables of another world; those with the same key are valid here too."""
        # The other's caches are emptied, because garbage collection would free their memory only much later.
        self._tables.take(other_light._tables)
        self._motions.take(other_light._motions)
        self._projector.inherit(other_light._projector)
        other_light.forget()

    def forget(self) -> None:
        """Drop every picture and table in memory."""
        pictures = (self._pictures, self._bases, self._albedos, self._others, self._lamp_shares)
        for kept in (self._tables, self._motions, self._erring, *pictures):
            kept.clear()
        self._projector.forget()
        self._displaced = None

    def _project_pattern(
        self, scene: SceneState, shown: ShownPattern, plane_weights: Floats | None
    ) -> PatternLevels:
        if plane_weights is None:
            return self._picture_of_state(scene, self._projector.states(shown.patterns), shown.index)
        planes = self._projector.planes(shown.pattern)
        picture = self._picture_of_state(scene, planes, 0).copy()
        for plane, weights in enumerate(plane_weights, start=1):
            picture += weights.astype(np.float32)[:, None] * self._picture_of_state(scene, planes, plane)
        return picture

    def _picture_of_state(self, setup: SceneState, levels: MirrorStates, index: int) -> PatternLevels:
        path = self._world.path
        if path == "transport":
            return self._looked_up_picture(setup, levels, index, None)
        if path == "reference" or any(setup.vibration_mm):  # a basis is not worth rendering for one picture
            return self._pictures.get(
                (setup, levels, index),
                lambda: self._render_channels(setup, levels.of(index)[None])[..., 0].mean(axis=0),
            )
        basis = self._projector.basis(levels)
        rendered = self._basis_under(setup, basis)
        weights = basis.weights[index].astype(np.float32)
        whole: PatternLevels = np.tensordot(weights, rendered.pictures, axes=1)
        if self._world.is_translucent(setup.item):
            return whole  # scattering below the surface smooths the quantisation residual away
        return whole + self._looked_up_picture(setup, levels, index, basis)

    def _looked_up_picture(
        self, setup: SceneState, levels: MirrorStates, index: int, subtracted: Basis | None
    ) -> PatternLevels:
        """Look up one picture, and several states at once, because their samples lie at the same places."""
        # subtracted: its combinations are taken off, so that only the quantisation residual is looked up.
        width, height = self._world.camera.size
        # Pictures of all set-ups of a frame are kept, or each would be looked up again for the next frame.
        picture_bytes = 4 * width * height
        max_batch = max(1, min(BATCH_PATTERNS, CACHE_BYTES // (SETUPS_OF_A_FRAME * picture_bytes)))
        if any(setup.vibration_mm):
            max_batch = 1  # the next frame has another displacement
        batch = math.ceil(levels.count / math.ceil(levels.count / max_batch))
        first = index - index % batch
        states = range(first, min(first + batch, levels.count))
        pictures = self._pictures.get(
            (setup, levels, subtracted, first), lambda: self._look_up(setup, levels, states, subtracted)
        )
        picture: PatternLevels = pictures[index - first]
        return picture

    def _look_up(
        self, setup: SceneState, levels: MirrorStates, states: range, basis: Basis | None
    ) -> PatternLevels:
        if basis is not None:
            light = [levels.of(n) - basis.level(n) for n in states]
            return self._pictures_from_table(setup, self._basis_under(setup, basis).table, light)
        light = [levels.of(n) for n in states]
        if self._background is None:
            return self._pictures_from_table(setup, self.table(setup), light)
        pictures = self._background.pictures(setup, light)
        if setup.item != NOTHING:
            pictures += self._pictures_from_table(setup, self.table(setup), light)
        return pictures

    def _pictures_from_table(
        self, setup: SceneState, table: LightTable, light: Sequence[PatternLevels]
    ) -> PatternLevels:
        """Look up pictures under mirrors at these light levels, (levels, height, width)."""
        _, scene, texture = self._built(setup)
        return table.look_up(texture.textures(light, scene.lamp.circles, table.part(texture.shape)))

    def _basis_under(self, setup: SceneState, basis: Basis) -> Rendered:
        return self._bases.get((setup, basis), lambda: self._render_basis(setup, basis))

    def _render_basis(self, setup: SceneState, basis: Basis) -> Rendered:
        """Render three channels at a time; the first render, with white as first channel, gives the table."""
        _, scene, texture = self._built(setup)
        first = self._render_channels(setup, basis.channels[:COLOURS], survey=True)
        white = texture.textures(basis.channels[:1], scene.lamp.circles)
        table = LightTable.of(first, scene).divided_by(white)
        self._albedos.put(setup, table.albedo)
        pictures = _average_views(first)
        for start in range(COLOURS, len(basis.channels), COLOURS):
            pictures += _average_views(self._render_channels(setup, basis.channels[start : start + COLOURS]))
        return Rendered(np.stack(pictures[: len(basis.channels)]), table)

    def _albedo(self, setup: SceneState) -> PatternLevels:
        """Get the mean reflectance of what every pixel sees, from any render of the set-up."""
        albedo: PatternLevels = self._albedos.get(setup, lambda: self._albedo_now(setup))
        return albedo

    def _albedo_now(self, setup: SceneState) -> PatternLevels:
        if self._background is None:
            return self.table(setup).albedo
        behind = self._background.albedo(setup)
        return behind if setup.item == NOTHING else behind + self.table(setup).albedo

    def _load_or_make(self, setup: SceneState, key: str) -> LightTable:
        _, scene, _ = self._built(setup)
        if self.computes(setup):
            return computed(scene, self._views(setup), spots=True)
        keep = self._cache if not any(setup.vibration_mm) else None
        table = keep.load(key) if keep else None
        if table is None:
            table = LightTable.of(
                self._render(setup, None, self._effort(bounces=0, samples=1, survey=True)), scene
            )
            if keep:
                keep.store(key, table)
        return table

    def pattern_render(self, setup: SceneState, pattern: Pattern) -> PatternRender:
        """Put together what a renderer needs for the picture under one pattern: the path `reference`."""
        render, world = self._world.render, self._world
        scene, texture = build_scene(world, setup, self._around)
        return PatternRender(
            scene,
            _lamp_textures(scene, texture, self._projector.level(pattern)[None])[..., 0],
            tuple(self._views(setup)),
            self._effort(render.bounces, render.samples, survey=False),
            world.ambient,
            self._falloff,
            point_lamps(world),
        )

    def _render_channels(
        self, setup: SceneState, channels: PatternLevels, survey: bool = False
    ) -> PatternLevels:
        """Render (views, height, width, …) under mirrors (up to three channels, rows, columns)."""
        render = self._world.render
        fine = _lamp_textures(*self._built(setup)[1:], channels)
        return self._render(setup, fine, self._effort(render.bounces, render.samples, survey))

    def _in_view(self, setup: SceneState) -> RenderScene:
        return self._built(setup)[1] if self._background is None else self._background.scene(setup)

    def _effort(self, bounces: int, samples: int, survey: bool) -> RenderSettings:
        return RenderSettings(samples, bounces, self._world.seed, self._world.render.device, survey)

    def _views(self, setup: SceneState) -> list[SubpixelView]:
        render = self._world.render
        more = render.computed_subpixels if self.computes(setup) else None
        return lens_views(more or render.subpixels, self._world.camera.aperture_mm)

    def _built(self, setup: SceneState) -> tuple[SceneState, RenderScene, MirrorTexture]:
        if self._scene is None or self._scene[0] != setup:
            around = self._around if self._background is None else ()
            self._scene = (setup, *build_scene(self._world, setup, around))
        return self._scene

    def _render(
        self, setup: SceneState, textures: PatternLevels | None, effort: RenderSettings
    ) -> PatternLevels:
        _, scene, _ = self._built(setup)
        views = self._views(setup)
        width, height = self._world.camera.size
        paths = width * height * len(views) * effort.samples * (1 + effort.bounces)
        return self._blender.render(scene, textures, views, effort, START_S + paths / PATHS_PER_S)


def _lamp_textures(scene: RenderScene, texture: MirrorTexture, channels: PatternLevels) -> PatternLevels:
    """Make the lamp's textures (circles, rows, columns, 3) of mirrors (up to three, rows, columns)."""
    fine = np.zeros((len(scene.lamp.circles), *scene.lamp.texture_shape, COLOURS), np.float32)
    for of_circle, circle in zip(fine, scene.lamp.circles, strict=True):
        for colour, light in enumerate(channels):
            of_circle[..., colour] = texture.fine(light, circle)
    return fine


def _average_views(rendered: PatternLevels) -> list[PatternLevels]:
    """Average the views of a render (views, height, width, …) to three pictures (height, width)."""
    total = np.zeros((*rendered.shape[1:3], COLOURS), np.float32)
    for view in rendered:  # in memory order, which is faster than a mean over the first axis
        total += view[..., :COLOURS]
    return list(np.moveaxis(total / np.float32(len(rendered)), -1, 0))
