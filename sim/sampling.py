"""Frames of some rows of the image alone, for predictions: light, sensor and vibration of whole frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Image, PixelIndices
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern
from fpplab.simulation.predictable import Rows
from fpplab.simulation.surface import PartSurface
from sim.build import Setup
from sim.fluctuation import Fluctuation
from sim.items import item_poses, part_mesh
from sim.light import Light, PatternLevels
from sim.sensor import SensorModel
from sim.vibration import displaced
from sim.world import World
from sim.world.surface import surface_of


class SimSampler:
    """A `fpplab.simulation.predictable.FrameSampler`.

    Parameters
    ----------
    world : World
        Devices, items and light.
    light : Light
        Of that world.
    """

    def __init__(self, world: World, light: Light) -> None:
        self._world, self._light = world, light
        self._dark: tuple[str, Rows, PatternLevels] | None = None
        self._seen: tuple[str, tuple[Pattern, ...], Rows, list[PatternLevels]] | None = None

    @property
    def calibration(self) -> Calibration:
        """The world's true models of both devices and the pose between them."""
        world = self._world
        return Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(), {})

    def mesh(self, item: str) -> trimesh.Trimesh:
        """Give the true shape of an artefact or part where it stands.

        Parameters
        ----------
        item : str
            Name of the item.

        Returns
        -------
        trimesh.Trimesh
            In mm in the camera's frame.

        Raises
        ------
        ConfigError
            There is no such item, or it is a board or card.
        """
        mesh = part_mesh(self._world, item)
        return mesh.copy().apply_transform(item_poses(self._world, item)[0].matrix)

    def surface(self, item: str) -> PartSurface | None:
        """Give the surface of an item as it was matched to a scan.

        Parameters
        ----------
        item : str
            Name of the item.

        Returns
        -------
        PartSurface or None
            None where the world's file alone tells what the item is made of.

        Raises
        ------
        ConfigError
            There is no such item.
        """
        return surface_of(self._world.material_of(item))

    def frames(
        self, item: str, patterns: Sequence[Pattern], settings: CameraSettings, rows: Rows, seed: int
    ) -> list[Image]:
        """Take frames of some rows, with noise, and vibration to first order.

        Parameters
        ----------
        item : str
            Name of the item.
        patterns : sequence of Pattern
            Patterns to show, one frame each.
        settings : CameraSettings
            Exposure, gain and bit depth.
        rows : Rows
            Rows of the image, (R,).
        seed : int
            Of noise and vibration, not negative.

        Returns
        -------
        list of Image
            Grey levels (R, width).

        Raises
        ------
        ConfigError
            The world has no such item.
        """
        still, *moved = self._pictures(item, tuple(patterns), rows)
        sensor, random = SensorModel.of(self._world), np.random.default_rng([self._world.seed, seed])
        found, changes = [], Fluctuation.of(self._world)
        for n in range(len(patterns)):
            picture = still[n]
            for there, step in zip(moved, random.standard_normal(3), strict=False):
                picture = picture + np.float32(step) * (there[n] - still[n])
            frame = len(patterns) * seed + n
            if changes is not None:
                picture = changes.applied(picture, self._ambient(item, rows), rows, frame)
            found.append(sensor.expose(np.maximum(picture, 0), settings, frame))
        return found

    def _ambient(self, item: str, rows: Rows) -> PatternLevels:
        """Irradiance (R, width) of the item without the projector, from two patterns: light is linear."""
        if self._dark is None or self._dark[0] != item or not np.array_equal(self._dark[1], rows):
            size, response = self._world.projector.size, self._world.projector.response
            black, white = (
                Pattern(f"even {level}", np.full(size[::-1], level, np.uint8)) for level in (0, 255)
            )
            pixels, setup = self._pixels(rows), Setup(item, held=item_poses(self._world, item)[0])
            least, most = self._light.irradiance_at(setup, (black, white), pixels)
            dark = least - np.float32(response.b / response.a) * (most - least)
            self._dark = item, rows, dark.reshape(len(rows), -1)
        return self._dark[2]

    def _pixels(self, rows: Rows) -> PixelIndices:
        width = self._world.camera.size[0]
        return np.repeat(rows, width), np.tile(np.arange(width), len(rows))

    def _pictures(self, item: str, patterns: tuple[Pattern, ...], rows: Rows) -> list[PatternLevels]:
        """Irradiance (n, R, width) of the item at rest and, where it vibrates, displaced along each axis."""
        if self._seen is not None:
            known, shown, of_rows, pictures = self._seen
            same = len(shown) == len(patterns) and all(a is b for a, b in zip(shown, patterns, strict=True))
            if known == item and same and np.array_equal(of_rows, rows):
                return pictures
        pose, pixels = item_poses(self._world, item)[0], self._pixels(rows)
        still, step = Setup(item, held=pose), self._world.vibration_mm
        setups = (still, *displaced(still, pose, step)) if step else (still,)
        seen = [self._light.irradiance_at(one, patterns, pixels) for one in setups]
        pictures = [one.reshape(len(patterns), len(rows), -1) for one in seen]
        self._seen = item, patterns, rows, pictures
        return pictures
