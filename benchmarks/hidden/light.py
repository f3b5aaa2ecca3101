"""Light of a hidden bench: that of its world, changed by its effects where they act.

The projector's falloff, the board's gloss and grain change what every sample of a pixel gives; a bent board
also moves where its samples lie on the projector and on the print, to first order in the bend, which is exact
to a few nm for tens of µm. The slopes of the bend change the light by less than 0.1 % and are left out. The
second lamp adds light without shadows, and the camera's gain scales all.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from benchmarks.hidden.effects import Effects, Falloff, Print
from benchmarks.hidden.foreign import Foreign
from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.conventions import Floats
from fpplab.core.geometry import RigidTransform
from fpplab.reconstruction.triangulation import camera_rays
from sim.build import SceneState
from sim.items import item_poses, item_shape
from sim.light import Light, PatternLevels, ShownPattern
from sim.light.plane import computed
from sim.light.table import LightTable
from sim.scene import Surface
from sim.worker import Blender
from sim.world import BoardItem, World

LAMP_AT_MM = np.array([0.0, 0.0, 450.0])
"""Where the level of the second lamp is stated for a surface that faces it."""
NOISE_PX_PER_MM = 4.0
"""Resolution at which the board's grain and mottle are drawn."""
WIDEST_MM = 100.0
"""Side of the square that they are drawn on, which holds the board."""


class HiddenLight(Light):
    """Light of a world with effects."""

    def __init__(
        self, world: World, blender: Blender, effects: Effects, foreign: Foreign | None = None
    ) -> None:
        super().__init__(world, blender, analytic=True)
        self.effects, self._blotches = effects, _blotches(effects)
        self.foreign = foreign or Foreign()
        self._gain = camera_gain(world, effects) * self.foreign.specks(*world.camera.size, 1)
        self._geometry: tuple[SceneState, Floats, Floats] | None = None

    def irradiance(
        self, setup: SceneState, show: ShownPattern | None, row_weights: Floats | None = None
    ) -> PatternLevels:
        """Compute the irradiance, that of the second lamp without its ripple."""
        # returns (height, width)
        seen = super().irradiance(setup, show, row_weights) * self._gain
        return np.asarray(seen + self.lamp(setup), np.float32)

    def lamp(self, setup: SceneState) -> PatternLevels:
        """Compute the light of the second lamp alone, without its ripple."""
        # returns (height, width)
        lamp = self.effects.lamp
        points, normals = self._surface(setup)
        to_lamp = np.array(lamp.place_mm) - points
        distance = np.linalg.norm(to_lamp, axis=-1)
        own = float(np.linalg.norm(np.array(lamp.place_mm) - LAMP_AT_MM))
        cosine = np.maximum(np.einsum("vui,vui->vu", to_lamp, normals) / distance, 0.0)
        level = lamp.level * cosine * (own / distance) ** 2
        falloff = 1.0 if self._falloff is None else self._falloff
        seen = np.nan_to_num(level) * self._albedo(setup) * falloff * self._gain
        return np.asarray(seen, np.float32)

    def _pictures_from_table(
        self, setup: SceneState, table: LightTable, light: Sequence[PatternLevels]
    ) -> PatternLevels:
        response = self._world.projector.response
        changed = [self.foreign.mirrors(one, response.a + response.b) for one in light]
        return super()._pictures_from_table(setup, table, changed)

    def _load_or_make(self, setup: SceneState, key: str) -> LightTable:
        board = isinstance(self._world.item(setup.item), BoardItem)
        table = self._printed(setup) if board else super()._load_or_make(setup, key)
        columns, rows = self._mirrors(setup, table)
        size = self._world.projector.size
        factor = falloff(self.effects.projector, columns, rows, size)
        left, top = table.corner
        height, width = table.samples.shape[1:3]
        if board:
            factor = factor * self._gloss(setup)[top : top + height, left : left + width]
        samples = table.samples.copy()
        samples[..., 3] *= factor.astype(np.float32)
        return replace(table, samples=samples)

    def _mirrors(self, setup: SceneState, table: LightTable) -> tuple[Floats, Floats]:
        """Projector pixels (K, h, w) of all samples."""
        affine = self._built(setup)[2].affine
        places = table.samples[..., :2].astype(np.float64) - affine[:, 2]
        u, v = np.moveaxis(places @ np.linalg.inv(affine[:, :2]).T, -1, 0)
        return u, v

    def _printed(self, setup: SceneState) -> LightTable:
        """The table of the bent board with its grain."""
        _, scene, texture = self._built(setup)
        board, pose = self.effects.board, self._pose(setup)
        surface = _with_blotches(scene.surfaces[0], self._blotches)
        surface = _seen_bent(surface, board, pose)
        table = computed(replace(scene, surfaces=(surface,)), self._views(setup), spots=True)
        points, _ = self._surface(setup)
        on_board = pose.inverse().apply(points.reshape(-1, 3)).reshape(points.shape)
        height_mm = bend(board, on_board[..., :2], _half_size(surface))
        steps = height_mm / np.einsum("vui,i->vu", points, pose.rotation[:, 2])
        model, to_projector = self._world.projector_model(), setup.T_projector_camera(self._world)
        there, here = (
            model.project((points * (1.0 + step[..., None])).reshape(-1, 3), to_projector)
            for step in (steps, 0 * steps)
        )
        shift = np.nan_to_num((there - here) @ texture.affine[:, :2].T).reshape(*steps.shape, 2)
        left, top = table.corner
        h, w = table.samples.shape[1:3]
        samples = table.samples.copy()
        samples[..., :2] += shift[top : top + h, left : left + w].astype(np.float32)
        return replace(table, samples=samples)

    def _gloss(self, setup: SceneState) -> Floats:
        """The light that comes back with the highlight, beside that of matt paper, (height, width)."""
        points, normals = self._surface(setup)
        lamp = setup.T_projector_camera(self._world).inverse().translation
        halfway = _unit(lamp - points) + _unit(-points)
        cosine = np.clip(np.einsum("vui,vui->vu", _unit(halfway), normals), 0.0, 1.0)
        board = self.effects.board
        return np.asarray(np.nan_to_num(1.0 + board.gloss * cosine**board.exponent, nan=1.0))

    def _pose(self, setup: SceneState) -> RigidTransform:
        return setup.held or item_poses(self._world, setup.item)[setup.pose]

    def _surface(self, setup: SceneState) -> tuple[Floats, Floats]:
        """Points and normals (height, width, 3) that pixels see in the camera's frame; NaN where none."""
        if self._geometry is None or self._geometry[0] != setup:
            vertices, faces = item_shape(self._world, setup.item)
            mesh = trimesh.Trimesh(self._pose(setup).apply(vertices), faces, process=False)
            rays = _unit(camera_rays(self._world.camera_model()))
            flat, shape = rays.reshape(-1, 3), RayTracedShape(mesh)
            depth, hit = shape.depth(np.zeros(3), flat), shape.first_face(np.zeros(3), flat)
            seen = np.isfinite(depth) & (hit >= 0)
            points, normals = np.full_like(flat, np.nan), np.full_like(flat, np.nan)
            points[seen], normals[seen] = flat[seen] * depth[seen, None], shape.normals[hit[seen]]
            # plates have no inside: what faces the camera counts
            normals *= -np.sign(np.einsum("pi,pi->p", normals, flat))[:, None]
            self._geometry = (setup, points.reshape(rays.shape), normals.reshape(rays.shape))
        return self._geometry[1:]


def falloff(of: Falloff, columns: Floats, rows: Floats, size: tuple[int, int]) -> Floats:
    """Compute a falloff at places of an image."""
    # size (width, height) px
    half = 0.5 * size[0]
    x, y = (columns + 0.5) / half - 1.0, (rows + 0.5 - 0.5 * size[1]) / half
    square = (x - of.centre[0]) ** 2 + (y - of.centre[1]) ** 2
    return np.asarray(np.maximum(1.0 - of.strength * square + of.slope[0] * x + of.slope[1] * y, 0.0))


def camera_gain(world: World, effects: Effects) -> Floats:
    """Compute the camera's gain beside that of its world: a smooth part and one of every pixel."""
    # returns (height, width)
    width, height = world.camera.size
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float64)
    smooth = falloff(effects.camera, columns, rows, (width, height))
    random = np.random.default_rng([effects.seed, 2])
    return smooth * (1.0 + effects.fixed_pattern * random.standard_normal((height, width)))


def bend(board: Print, places_mm: Floats, half_mm: Floats) -> Floats:
    """Compute the height of a bent board above its plane, along its own z."""
    # places_mm (..., 2); half_mm (2,)
    x, y = np.moveaxis(places_mm / half_mm, -1, 0)
    return np.asarray(board.sag_mm * (1.0 - 0.5 * (x**2 + y**2)) + board.twist_mm * x * y)


def _blotches(effects: Effects) -> NDArray[np.float32]:
    """Relative reflectance of the board, at `NOISE_PX_PER_MM`."""
    random, side = np.random.default_rng([effects.seed, 3]), int(WIDEST_MM * NOISE_PX_PER_MM)
    total = np.ones((side, side), np.float32)
    board = effects.board
    for share, size in ((board.grain, board.grain_mm), (board.mottle, board.mottle_mm)):
        noise = random.standard_normal((side, side), np.float32)
        smooth = np.asarray(cv2.GaussianBlur(noise, (0, 0), size * NOISE_PX_PER_MM), np.float32)
        total += share * smooth / smooth.std()
    return total


def _with_blotches(surface: Surface, blotches: NDArray[np.float32]) -> Surface:
    """Print them: the picture becomes finer grained, between black and the brightest place."""
    paint, picture = surface.paint, surface.picture
    assert picture is not None
    rows, columns = picture.shape
    width, height = 2 * _half_size(surface)
    part = blotches[: round(height * NOISE_PX_PER_MM), : round(width * NOISE_PX_PER_MM)]
    fine = cv2.resize(part, (columns, rows), interpolation=cv2.INTER_CUBIC)
    share = picture.astype(np.float32) / 255.0
    reflectance = (paint.ink + (paint.reflectance - paint.ink) * share) * fine
    brightest = float(reflectance.max())
    codes = np.rint(255.0 * reflectance / brightest).astype(np.uint8)
    return replace(surface, paint=replace(paint, reflectance=brightest, ink=0.0), picture=codes)


def _seen_bent(surface: Surface, board: Print, pose: RigidTransform) -> Surface:
    """Move the print to where the camera's rays through the plane meet the bent board."""
    picture, half = surface.picture, _half_size(surface)
    assert picture is not None
    rows, columns = picture.shape
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float64)
    scale = np.array([columns, rows]) / (2 * half)
    places = np.stack([(u + 0.5) / scale[0], (v + 0.5) / scale[1]], axis=-1) - half
    camera = pose.inverse().translation
    along = np.concatenate([places - camera[:2], np.full((rows, columns, 1), -camera[2])], axis=-1)
    shift = (bend(board, places, half) / along[..., 2])[..., None] * along[..., :2] * scale
    maps = [(one + shift[..., axis]).astype(np.float32) for axis, one in enumerate((u, v))]
    moved = cv2.remap(picture, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return replace(surface, picture=np.asarray(moved, np.uint8))


def _half_size(surface: Surface) -> Floats:
    return np.asarray(0.5 * (surface.vertices[2, :2] - surface.vertices[0, :2]))


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
