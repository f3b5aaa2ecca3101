"""Frames of parts of the image alone, for predictions: light, sensor and vibration of whole frames."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Image, PixelIndices
from fpplab.devices import CameraSettings
from fpplab.devices.simulation import Columns, Rows
from fpplab.patterns.fringes import Pattern
from sim.build import SceneState
from sim.fluctuation import Fluctuation, displaced, displacement_mm
from sim.items import item_poses, part_mesh
from sim.light import Light, PatternLevels
from sim.light.cache import ByteLimitedCache
from sim.part_surface import PartSurface
from sim.sensor import SensorModel, colour_shares
from sim.world import World
from sim.world.materials.base import surface_of


@dataclass(frozen=True, eq=False)
class FramePart:
    """Rows and columns of an item's frames."""

    item: str  # name of the item
    rows: Rows  # rows of the image, (R,)
    columns: Columns  # columns of the image, (C,)

    @property
    def key(self) -> tuple[str, bytes, bytes]:
        return self.item, self.rows.tobytes(), self.columns.tobytes()

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.rows), len(self.columns)

    @property
    def pixels(self) -> PixelIndices:
        return np.repeat(self.rows, len(self.columns)), np.tile(self.columns, len(self.rows))


class ImagePartSampler:
    """A `fpplab.devices.simulation.FrameSampler` of a world."""

    def __init__(self, world: World, light: Light) -> None:
        self._world, self._light = world, light
        # Light that other noise is drawn to.
        self._dark: ByteLimitedCache[PatternLevels] = ByteLimitedCache(1 << 28)
        self._lamp_shares: ByteLimitedCache[PatternLevels] = ByteLimitedCache(1 << 28)
        self._seen: ByteLimitedCache[PatternLevels] = ByteLimitedCache(1 << 28)

    @property
    def calibration(self) -> Calibration:
        """The world's true models of both devices and the pose between them."""
        world = self._world
        return Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(), {})

    def mesh(self, item: str) -> trimesh.Trimesh:
        """Give the true shape of an artefact or part where it stands."""
        mesh = part_mesh(self._world, item)
        return mesh.copy().apply_transform(item_poses(self._world, item)[0].matrix)

    def surface(self, item: str) -> PartSurface | None:
        return surface_of(self._world.material_of(item))

    def frames(
        self,
        item: str,
        patterns: Sequence[Pattern],
        settings: CameraSettings,
        rows: Rows,
        seed: int,
        columns: Columns | None = None,
    ) -> list[Image]:
        """Take frames of some rows and columns, with noise, and vibration to first order."""
        # rows (R,); columns (C,); returns (R, C)
        frame_part = FramePart(
            item, rows, np.arange(self._world.camera.size[0]) if columns is None else columns
        )
        still, *moved = self._pictures(frame_part, tuple(patterns))
        sensor, random = SensorModel.of(self._world), np.random.default_rng([self._world.seed, seed])
        taken, changes = [], Fluctuation.of(self._world, seed)
        shares = colour_shares(self._world, item)[np.ix_(rows, frame_part.columns)]
        size_mm = self._world.moves_mm or 1.0
        for n in range(len(patterns)):
            picture, steps = still[n], displacement_mm(self._world, random, n, seed) / size_mm
            for shifted, step in zip(moved, steps, strict=False):
                picture = picture + np.float32(step) * (shifted[n] - still[n])
            frame = len(patterns) * seed + n
            if changes is not None:
                room_light, lamp_share = self._room_light(frame_part), self._lamp_share(frame_part)
                picture = changes.applied(picture, room_light, lamp_share, rows, frame)
            taken.append(sensor.expose(np.maximum(picture, 0) * shares, settings, frame))
        return taken

    def _lamp_share(self, frame_part: FramePart) -> PatternLevels:
        setup = SceneState(frame_part.item, held=item_poses(self._world, frame_part.item)[0])
        return self._lamp_shares.get(
            frame_part.key,
            lambda: self._light.lamp_share(setup, frame_part.pixels).reshape(frame_part.shape),
        )

    def _room_light(self, frame_part: FramePart) -> PatternLevels:
        """Irradiance (R, C) of the item without the projector, from two patterns: light is linear."""
        return self._dark.get(frame_part.key, lambda: self._room_light_now(frame_part))

    def _room_light_now(self, frame_part: FramePart) -> PatternLevels:
        size, response = self._world.projector.size, self._world.projector.response
        black, white = (Pattern(f"even {level}", np.full(size[::-1], level, np.uint8)) for level in (0, 255))
        setup = SceneState(frame_part.item, held=item_poses(self._world, frame_part.item)[0])
        under_black, under_white = self._light.irradiance_at(setup, (black, white), frame_part.pixels)
        dark: PatternLevels = under_black - np.float32(response.b / response.a) * (under_white - under_black)
        return dark.reshape(frame_part.shape)

    def _pictures(self, where: FramePart, patterns: tuple[Pattern, ...]) -> PatternLevels:
        """Irradiance (k, n, R, C) of the item at rest and, where it vibrates, displaced along each axis."""
        return self._seen.get((where.key, patterns), lambda: self._pictures_now(where, patterns))

    def _pictures_now(self, frame_part: FramePart, patterns: tuple[Pattern, ...]) -> PatternLevels:
        pose, step = item_poses(self._world, frame_part.item)[0], self._world.moves_mm
        still = SceneState(frame_part.item, held=pose)
        setups = (still, *displaced(still, pose, step)) if step else (still,)
        irradiance = np.stack(
            [self._light.irradiance_at(setup, patterns, frame_part.pixels) for setup in setups]
        )
        return irradiance.reshape(len(setups), len(patterns), *frame_part.shape)
