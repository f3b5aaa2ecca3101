"""The digital twin that is matched to a bench: a world whose parameters can be set, used without a session.

Boards and cards are flat, so their light is computed (`sim.light.plane`) and an evaluation takes no render.
The effect of mirror switching on exposures that are not whole periods is left out: on average over the phases
it is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any
from weakref import finalize

import numpy as np
import trimesh
from numpy.typing import NDArray

from fpplab.calibration.model import CalibrationFile
from fpplab.core import config
from fpplab.core.conventions import Floats, Image, PixelIndices
from fpplab.core.errors import ConfigError
from fpplab.core.files import write_text
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern
from sim.appearance import Appearance
from sim.build import Setup
from sim.fluctuation import Fluctuation
from sim.items import board_target, item_poses, part_mesh
from sim.light import Light, PatternLevels, Show
from sim.parameters import TwinParameters, parameters_of, world_of
from sim.sensor import SensorModel
from sim.sheet import board_relative_to, save_sheet
from sim.surroundings import save_surroundings
from sim.vibration import displaced, displacement_mm, wave_phase, with_vibration
from sim.worker import Blender
from sim.world import BoardItem, World

ExpectedLevels = NDArray[np.float32]
"""Raw levels without noise and without rounding, (n, h, w), clipped to 0 … full scale."""


class Twin:
    """A simulation of a board whose parameters can be set.

    Poses are indices into `parameters.poses`; frames and levels are raw, of the bit depth of the settings.
    """

    def __init__(self, nominal: World, board: str, blender: Blender) -> None:
        item = nominal.item(board)
        if not isinstance(item, BoardItem):
            boards = ", ".join(name for name, i in nominal.items.items() if isinstance(i, BoardItem))
            raise ConfigError(f"world: 'items.{board}' is no board; there are {boards or 'none'}")
        self._nominal, self._board, self._blender = nominal, board, blender
        self.target = board_target(board, item)
        self._parameters = parameters_of(nominal, board, self.target)
        self._world = world_of(nominal, board, self._parameters)
        self._light = Light(self._world, blender, analytic=True)
        self._next_frame, self._settings = 0, CameraSettings(1.0)
        self._appearance: Appearance | None = None
        self._forget_files: Callable[[], object] = lambda: None

    @property
    def parameters(self) -> TwinParameters:
        """As it stands; at first what its own file says."""
        return self._parameters

    @property
    def next_frame(self) -> int:
        """Number of the next frame, counted since the twin was made; noise and vibration follow from it."""
        return self._next_frame

    def count_frames_from(self, number: int) -> None:
        """Give the next frame this number."""
        self._next_frame = number

    def become(self, parameters: TwinParameters) -> None:
        """Go on with these. Tables of light are kept for all geometry that comes again."""
        world = world_of(self._nominal, self._board, parameters)
        light = Light(world, self._blender, analytic=True)
        light.inherit(self._light)
        self._parameters, self._world, self._light = parameters, world, light

    def expected(self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings) -> ExpectedLevels:
        """Compute what the camera sees of the board on average, without noise and vibration."""
        # returns (n, h, w)
        return self._expected(Setup(self._board, held=self._parameters.poses[pose]), patterns, settings)

    def expected_at(
        self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings, pixels: PixelIndices
    ) -> ExpectedLevels:
        """Compute what `expected` gives at some pixels only."""
        # returns (n, P)
        self._settings = settings
        return self.expected_part(self._board, self._parameters.poses[pose], patterns, settings, pixels)

    def expected_with_slopes(
        self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings, pixels: PixelIndices
    ) -> tuple[ExpectedLevels, ExpectedLevels] | None:
        """Compute what `expected_at` gives, with derivatives by the places that the pixels see."""
        # returns (n, P) mm
        setup = Setup(self._board, held=self._parameters.poses[pose])
        light = self._light.differentiated(setup)
        if light is None:
            return None
        irradiance, slopes = light.at(tuple(patterns), pixels)
        self._settings, scale = settings, SensorModel.of(self._world).grey_scale(settings)
        levels = scale.levels(irradiance)
        slopes *= np.float32(scale.slope) * (levels < scale.saturated)[..., None]
        return levels, slopes

    def expected_of(self, item: str, patterns: Sequence[Pattern], settings: CameraSettings) -> ExpectedLevels:
        """Compute what the camera sees of another item of the world on average."""
        # returns (n, h, w)
        return self._expected(Setup(item), patterns, settings)

    def expected_part(
        self,
        item: str,
        pose: RigidTransform,
        patterns: Sequence[Pattern],
        settings: CameraSettings,
        pixels: PixelIndices,
    ) -> ExpectedLevels:
        """Compute what the camera sees on average of an item in any pose, at some pixels only."""
        # returns (n, P)
        irradiance = self._light.irradiance_at(Setup(item, held=pose), tuple(patterns), pixels)
        return SensorModel.of(self._world).expected(irradiance, settings)

    def frames(self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings) -> list[Image]:
        """Simulate frames of the board with the sensor's noise and the item's vibration."""
        return self.scan(self._board, self._parameters.poses[pose], patterns, settings)

    def scan(
        self, item: str, pose: RigidTransform, patterns: Sequence[Pattern], settings: CameraSettings
    ) -> list[Image]:
        """Simulate frames of an item in any pose, with the sensor's noise and the item's vibration.

        Vibration is computed to first order in the displacement: by derivatives of the light where it is
        computed, else from four pictures of each pattern that serve any number of frames.
        """
        self._world.item(item)
        shown, sensor, self._settings = tuple(patterns), SensorModel.of(self._world), settings
        still, size_mm, phase = Setup(item, held=pose), self._world.moves_mm, wave_phase(self._world)
        counters = range(self._next_frame, self._next_frame + len(shown))
        self._next_frame = counters.stop
        moves = np.array([self._displacement(n, phase) for n in counters])
        if not size_mm:
            pictures = [self._irradiance(still, shown, n) for n in range(len(shown))]
        elif light := self._light.differentiated(still):
            pictures = list(light.displaced(shown, moves))
        else:
            moved = displaced(still, pose, size_mm)
            pictures = [
                with_vibration(self._light, still, moved, steps, Show(shown, n))
                for n, steps in enumerate(moves / size_mm)
            ]
        if (changes := Fluctuation.of(self._world)) is not None:
            ambient = self._light.irradiance(still, None)
            rows = np.arange(len(ambient))
            pictures = [
                changes.applied(of, ambient, rows, n) for of, n in zip(pictures, counters, strict=True)
            ]
        with ThreadPoolExecutor() as pool:
            return list(pool.map(lambda of, n: sensor.expose(of, settings, n), pictures, counters))

    def _displacement(self, frame: int, phase: float) -> Floats:
        random = np.random.default_rng([self._world.seed, frame])
        return displacement_mm(self._world, random, frame, phase)

    def mesh(self, item: str) -> trimesh.Trimesh:
        """Give the true shape of an artefact or part."""
        return part_mesh(self._world, item)

    def pose_of(self, item: str) -> RigidTransform:
        """Tell where an item of the world stands."""
        return item_poses(self._world, item)[0]

    def appear(self, appearance: Appearance) -> None:
        """Look as a bench does, beside what parameters tell; `save` writes it too."""
        folder = Path(mkdtemp(prefix="fpplab-"))
        changed = self._with_appearance(self._nominal, appearance, folder)
        self._forget_files()
        self._forget_files = finalize(self, rmtree, folder, ignore_errors=True)
        self._nominal, self._appearance = self._nominal.model_copy(update=changed), appearance
        self.become(self._parameters)

    def _with_appearance(
        self, world: World, appearance: Appearance, folder: Path, relative: bool = False
    ) -> dict[str, Any]:
        """What an appearance, whose files are written to a folder, changes in a world."""
        around = appearance.surroundings and save_surroundings(appearance.surroundings, folder)
        board = world.items[self._board]
        assert isinstance(board, BoardItem)
        board = board.model_copy(update=save_sheet(appearance.sheet, folder))
        if relative:
            around = around and around.relative_to(folder)
            board = board_relative_to(board, folder)
        return {"surroundings": around, "items": {**world.items, self._board: board}}

    def save(self, folder: Path, notes: Sequence[str] = ()) -> Path:
        """Write `rig.yaml`, `world.yaml` and `calibration.yaml`.

        The camera's bit depth and gain in the rig file are those last used.
        """
        calibration = CalibrationFile.of(self._parameters.calibration)
        changed: dict[str, Any] = {"calibration": calibration}
        if self._appearance is not None:
            changed |= self._with_appearance(self._world, self._appearance, folder, relative=True)
        world = self._world.model_copy(update=changed).save(folder)
        devices: dict[str, dict[str, Any]] = {name: {"backend": f"virtual_{name}"} for name in _DEVICES}
        devices["camera"] |= {"bits": self._settings.bits, "gain_db": self._settings.gain_db}
        bench = {"backend": "virtual_bench", "world": world.name}
        path = folder / "rig.yaml"
        noted = {"notes": list(notes)} if notes else {}
        write_text(path, config.to_yaml({"name": "Matched twin", **noted, "bench": bench, **devices}))
        return path

    def _expected(
        self, setup: Setup, patterns: Sequence[Pattern], settings: CameraSettings
    ) -> ExpectedLevels:
        shown, sensor, self._settings = tuple(patterns), SensorModel.of(self._world), settings
        width, height = self._world.camera.size
        levels = np.empty((len(shown), height, width), np.float32)
        for n, level in enumerate(levels):
            level[:] = sensor.expected(self._irradiance(setup, shown, n), settings)
        return levels

    def _irradiance(self, setup: Setup, patterns: tuple[Pattern, ...], n: int) -> PatternLevels:
        return self._light.irradiance(setup, Show(patterns, n))


_DEVICES = ("camera", "projector", "stage", "fixture")
