"""The digital twin that is matched to a bench: a world with parameters, used without a session.

Boards and cards are flat, so their light is computed (`sim.light.plane`) and an evaluation takes no render.
The effect of mirror switching on exposures that are not whole periods is left out: on average over the phases
it is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import chain
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
from fpplab.core.conventions import Floats, Image, Map, PixelIndices
from fpplab.core.errors import ConfigError
from fpplab.core.files import write_text
from fpplab.core.geometry import RigidTransform
from fpplab.core.progress import ignore
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern, uniform_patterns
from fpplab.patterns.mosaic import Bayer
from fpplab.targets import Target
from sim.appearance import Appearance
from sim.build import SceneState
from sim.fluctuation import Fluctuation, displaced, displaced_irradiance, displacement_mm
from sim.items import board_target, item_poses, part_mesh
from sim.light import Light, PatternLevels, ShownPattern
from sim.light.point_errors import error_draw
from sim.parameters import TwinParameters, parameters_of, world_of
from sim.sensor import SensorModel, colour_shares
from sim.sheet import board_relative_to, save_sheet, save_surroundings
from sim.worker import Blender
from sim.world import BoardItem, World
from sim.world.camera import ColourFilter

ExpectedLevels = NDArray[np.float32]
"""Raw levels without noise and without rounding, (n, h, w), clipped to 0 … full scale."""


class Lights:
    """Light of the worlds that twins derived from one another have; tables that are still valid are kept.

    The light of one world is kept at a time: twins that take turns make theirs again from shared tables.
    """

    def __init__(self, blender: Blender) -> None:
        self._blender = blender
        self._world: World | None = None
        self._light: Light | None = None

    def of(self, world: World) -> Light:
        if self._light is None or self._world is not world:
            light = Light(world, self._blender, analytic=True)
            if self._light is not None:
                light.inherit(self._light)
            self._world, self._light = world, light
        return self._light


@dataclass
class FrameCounter:
    """Number of the next frame of all twins derived from one another."""

    next_frame: int = 0

    def take(self, count: int) -> range:
        numbers = range(self.next_frame, self.next_frame + count)
        self.next_frame = numbers.stop
        return numbers


class TemporaryFolder:
    """A folder that is removed with the last twin that needs its files."""

    def __init__(self) -> None:
        self.path = Path(mkdtemp(prefix="fpplab-"))
        finalize(self, rmtree, self.path, ignore_errors=True)


@dataclass(frozen=True, eq=False)
class Twin:
    """A simulation of a board: what its camera sees follows from its parameters, which never change.

    `with_parameters` gives a twin with others; both share tables of light that are valid for both, so that an
    evaluation costs what its change costs. Poses are indices into `parameters.poses`; frames and levels are
    raw, of the bit depth of the settings. Noise and vibration of a frame follow from its number.

    Examples
    --------
    >>> brighter = twin.with_parameters(dataclasses.replace(twin.parameters, ambient=0.02))
    >>> levels = brighter.expected(0, patterns, settings)
    """

    nominal: World  # with all that parameters do not say
    board: str  # name of the board in the world
    target: Target  # the board, as it is printed
    parameters: TwinParameters
    world: World  # `nominal` with `parameters`
    lights: Lights
    frame_counter: FrameCounter
    appearance: Appearance | None = None  # of sheet and surroundings, where it is not the file's own
    files: TemporaryFolder | None = None  # of the appearance
    before_images: Callable[[], object] = ignore  # called before images of the board are computed

    @classmethod
    def of(cls, nominal: World, board: str, blender: Blender) -> Twin:
        """Make the twin that a world describes; `ConfigError` where it has no such board."""
        item = nominal.item(board)
        if not isinstance(item, BoardItem):
            boards = ", ".join(name for name, i in nominal.items.items() if isinstance(i, BoardItem))
            raise ConfigError(f"world: 'items.{board}' is no board; there are {boards or 'none'}")
        target = board_target(board, item)
        parameters = parameters_of(nominal, board, target)
        world = world_of(nominal, board, parameters)
        return cls(nominal, board, target, parameters, world, Lights(blender), FrameCounter())

    @property
    def next_frame(self) -> int:
        """Number of the next frame, counted since the first of these twins was made."""
        return self.frame_counter.next_frame

    def count_frames_from(self, number: int) -> None:
        """Number frames from here on: a continued matching then has the noise of an undisturbed one."""
        self.frame_counter.next_frame = number

    def with_parameters(self, parameters: TwinParameters) -> Twin:
        """Make a twin with other parameters; `ConfigError` where no world can have them."""
        world = world_of(self.nominal, self.board, parameters)
        return replace(self, parameters=parameters, world=world)

    def with_progress(self, before_images: Callable[[], object]) -> Twin:
        """Make a twin that calls a function before it computes images of its board or of parts."""
        # The function may raise to end the work.
        return replace(self, before_images=before_images)

    def with_filter(self, bayer: Bayer | None, white: tuple[float, float, float] | None) -> Twin:
        """Make a twin whose camera has a Bayer filter that sees white light in these shares, or none."""
        colour_filter = None
        if bayer is not None and white is not None:
            red, green, blue = ((share / max(white),) * 3 for share in white)
            colour_filter = ColourFilter(pattern=bayer, red=red, green=green, blue=blue)
        camera = self.nominal.camera.model_copy(update={"bayer": colour_filter})
        nominal = self.nominal.model_copy(update={"camera": camera})
        return replace(self, nominal=nominal, world=world_of(nominal, self.board, self.parameters))

    def with_appearance(self, appearance: Appearance) -> Twin:
        """Make a twin whose sheet and surroundings look as a bench's do; `save` writes them too."""
        files = TemporaryFolder()
        changed = self._appearance_in_world(self.nominal, appearance, files.path)
        nominal = self.nominal.model_copy(update=changed)
        world = world_of(nominal, self.board, self.parameters)
        return replace(self, nominal=nominal, world=world, appearance=appearance, files=files)

    def expected(self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings) -> ExpectedLevels:
        """Compute what the camera sees of the board on average, without noise and vibration."""
        # returns (n, h, w)
        self.before_images()
        return self._expected_levels(self._setup(pose), patterns, settings)

    def expected_at(
        self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings, pixels: PixelIndices
    ) -> ExpectedLevels:
        """Compute what `expected` gives at some pixels only."""
        # returns (n, P)
        self.before_images()
        return self._expected_at(self._setup(pose), patterns, settings, pixels)

    def expected_with_slopes(
        self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings, pixels: PixelIndices
    ) -> tuple[ExpectedLevels, ExpectedLevels] | None:
        """Compute what `expected_at` gives, with derivatives by the places that the pixels see."""
        # returns (n, P) and (n, P, 4): by x, y on the board in mm and u, v on the projector in px; None where
        # the light has no derivatives
        self.before_images()
        light = self._light.differentiated(self._setup(pose))
        if light is None:
            return None
        irradiance, slopes = light.at(tuple(patterns), pixels)
        if (shares := self._filter(self.board)) is not None:
            irradiance = irradiance * shares[pixels]
            slopes *= shares[pixels][:, None]
        scale = SensorModel.of(self.world).grey_scale(settings)
        levels = scale.levels(irradiance)
        slopes *= np.float32(scale.slope) * (levels < scale.saturated)[..., None]
        return levels, slopes

    def expected_of_greys(
        self, item: str, greys: Floats, settings: CameraSettings
    ) -> Iterator[NDArray[np.float32]]:
        """Compute what the camera sees on average of another item under uniform grey levels."""
        # greys (L,), as shares of white; yields L pictures (h, w). Light is linear: two pictures serve all.
        self.world.item(item)
        projector, setup = self.world.projector, SceneState(item)
        ends = tuple(uniform_patterns([0, 255], projector.size))
        dark, white = (self._irradiance(setup, ends, n) for n in range(2))
        shares, sensor = self._filter(item), SensorModel.of(self.world)
        light = projector.response.apply(np.concatenate([[0.0, 1.0], greys]))
        for share in ((light[2:] - light[0]) / (light[1] - light[0])).tolist():
            irradiance = dark + np.float32(share) * (white - dark)
            yield sensor.expected(irradiance if shares is None else irradiance * shares, settings)

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
        self.before_images()
        return self._expected_at(SceneState(item, held=pose), patterns, settings, pixels)

    def frames(self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings) -> list[Image]:
        """Simulate frames of the board with the sensor's noise and the item's vibration."""
        self.before_images()
        return self.scan(self.board, self.parameters.poses[pose], patterns, settings)

    def scan(
        self, item: str, pose: RigidTransform, patterns: Sequence[Pattern], settings: CameraSettings
    ) -> list[Image]:
        """Simulate frames of an item in any pose, with the sensor's noise and the item's vibration."""
        # Vibration is computed to first order in the displacement: by derivatives of the light where it is
        # computed, else from four pictures of each pattern that serve any number of frames.
        self.world.item(item)
        shown, sensor = tuple(patterns), SensorModel.of(self.world)
        still = SceneState(item, held=pose, error_draw=error_draw(pose))
        counters = self.frame_counter.take(len(shown))
        changes, shares = Fluctuation.of(self.world), self._filter(item)
        # Pictures are made one by one while others are exposed: all at once would be of some 200 MB. The
        # first traces the rays, with their derivatives, that the light of the room needs too.
        pictures = self._levels_of_vibrating_frames(still, pose, shown, counters)
        first = next(pictures)
        change = None if changes is None else changes.in_whole_frames(self._light, still)

        def exposed(picture: PatternLevels, number: int) -> Image:
            if change is not None:
                picture = change(picture, number)
            return sensor.expose(picture if shares is None else picture * shares, settings, number)

        with ThreadPoolExecutor() as pool:
            return list(pool.map(exposed, chain((first,), pictures), counters))

    def _levels_of_vibrating_frames(
        self, still: SceneState, pose: RigidTransform, shown: tuple[Pattern, ...], counters: range
    ) -> Iterator[PatternLevels]:
        """Compute the irradiance (h, w) of every frame of an item that vibrates about a pose."""
        size_mm = self.world.moves_mm
        if not size_mm:
            return (self._irradiance(still, shown, n) for n in range(len(shown)))
        moves = np.array([self._displacement(n) for n in counters])
        if light := self._light.differentiated(still):
            return light.displaced(shown, moves)
        moved = displaced(still, pose, size_mm)
        return (
            displaced_irradiance(self._light, still, moved, steps, ShownPattern(shown, n))
            for n, steps in enumerate(moves / size_mm)
        )

    def _displacement(self, frame: int) -> Floats:
        random = np.random.default_rng([self.world.seed, frame])
        return displacement_mm(self.world, random, frame)

    def mesh(self, item: str) -> trimesh.Trimesh:
        return part_mesh(self.world, item)

    def pose_of(self, item: str) -> RigidTransform:
        return item_poses(self.world, item)[0]

    def _appearance_in_world(
        self, world: World, appearance: Appearance, folder: Path, relative: bool = False
    ) -> dict[str, Any]:
        """What an appearance, whose files are written to a folder, changes in a world."""
        around = appearance.surroundings and save_surroundings(appearance.surroundings, folder)
        board = world.items[self.board]
        assert isinstance(board, BoardItem)
        board = board.model_copy(update=save_sheet(appearance.sheet, folder))
        if relative:
            around = around and around.relative_to(folder)
            board = board_relative_to(board, folder)
        return {"surroundings": around, "items": {**world.items, self.board: board}}

    def save(self, folder: Path, settings: CameraSettings, notes: Sequence[str] = ()) -> Path:
        """Write `rig.yaml`, `world.yaml` and `calibration.yaml`."""
        # The rig file has the camera's bit depth and gain of `settings`, and notes for every command that
        # opens it.
        calibration = CalibrationFile.of(self.parameters.calibration)
        changed: dict[str, Any] = {"calibration": calibration}
        if self.appearance is not None:
            changed |= self._appearance_in_world(self.world, self.appearance, folder, relative=True)
        world = self.world.model_copy(update=changed).save(folder)
        devices: dict[str, dict[str, Any]] = {name: {"backend": f"virtual_{name}"} for name in _DEVICES}
        devices["camera"] |= {"bits": settings.bits, "gain_db": settings.gain_db}
        bench = {"backend": "virtual_bench", "world": world.name}
        path = folder / "rig.yaml"
        noted = {"notes": list(notes)} if notes else {}
        write_text(path, config.to_yaml({"name": "Matched twin", **noted, "bench": bench, **devices}))
        return path

    def _expected_levels(
        self, setup: SceneState, patterns: Sequence[Pattern], settings: CameraSettings
    ) -> ExpectedLevels:
        shown, sensor = tuple(patterns), SensorModel.of(self.world)
        width, height = self.world.camera.size
        levels = np.empty((len(shown), height, width), np.float32)
        shares = self._filter(setup.item)
        for n, level in enumerate(levels):
            irradiance = self._irradiance(setup, shown, n)
            level[:] = sensor.expected(irradiance if shares is None else irradiance * shares, settings)
        return levels

    def _irradiance(self, setup: SceneState, patterns: tuple[Pattern, ...], n: int) -> PatternLevels:
        return self._light.irradiance(setup, ShownPattern(patterns, n))

    def _expected_at(
        self, setup: SceneState, patterns: Sequence[Pattern], settings: CameraSettings, pixels: PixelIndices
    ) -> ExpectedLevels:
        irradiance = self._light.irradiance_at(setup, tuple(patterns), pixels)
        if (shares := self._filter(setup.item)) is not None:
            irradiance = irradiance * shares[pixels]
        return SensorModel.of(self.world).expected(irradiance, settings)

    def _filter(self, item: str) -> Map | None:
        """Share of the light that each pixel of a Bayer camera gets; None without a filter."""
        # returns (height, width)
        return None if self.world.camera.bayer is None else colour_shares(self.world, item)

    def _setup(self, pose: int) -> SceneState:
        return SceneState(self.board, held=self.parameters.poses[pose])

    @property
    def _light(self) -> Light:
        return self.lights.of(self.world)


_DEVICES = ("camera", "projector", "stage", "fixture")
