"""The virtual bench: one simulated world, and the state of everything in it that moves."""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from sim.build import SceneState, build_scene, is_lit_in_view
from sim.effects import EFFECTS
from sim.fluctuation import Fluctuation, displaced, displaced_irradiance, displacement_mm
from sim.items import item_poses
from sim.light import Light, PatternLevels, ShownPattern
from sim.light.point_errors import error_draw, point_error_sizes
from sim.sampling import ImagePartSampler
from sim.scene import RenderSettings, SubpixelView
from sim.studio import SimStudio
from sim.timing import is_whole, plane_weights
from sim.twin import Twin
from sim.worker import START_S, Blender
from sim.world import Binning, Subpixels, World

UNNAMED = "world: "  # what begins a refusal by a module that does not know the world's file


class VirtualBenchOptions(Document):
    """The section `bench` of a rig file.

    Fewer `subpixels` and `still` make searches quick: an item at rest takes one table of light, a vibrating
    item takes four.
    """

    world: str
    """World file, by path or by the name of one that comes with fpplab."""
    binning: Binning | None = None
    """The camera's binning, in place of the world's."""
    analytic: bool = False
    """Whether light on flat, matt items is computed instead of rendered, see `sim.light.plane`."""
    subpixels: Subpixels | None = None
    """As in `sim.world.Render`, in place of the world's."""
    still: bool = False
    """Whether vibration is switched off."""

    def load_world(self) -> World:
        world = World.load(self.world)
        if self.binning is not None:
            world = world.binned(self.binning)
        if self.subpixels is not None:
            render = world.render.model_copy(update={"subpixels": self.subpixels})
            world = world.model_copy(update={"render": render})
        return _world_without_displacement(world) if self.still else world


def _world_without_displacement(world: World) -> World:
    data = world.model_dump(mode="json")
    for effect in EFFECTS:
        if effect.displacement_size_mm(world):
            effect.clear(data)
    return config.validate(data, World, "world")


class VirtualBench:
    """What the simulated devices share: the world, all that moves, and Blender from the first picture on."""

    def __init__(self, options: dict[str, Any]) -> None:
        chosen = config.validate(options, VirtualBenchOptions, "bench")
        self._file = config.find_config(chosen.world, "world")
        self.world = chosen.load_world()
        self.blender = Blender("bench")
        self._analytic = chosen.analytic
        self.light = self._light_of(self.world)
        self.setup = SceneState(self.world.mounted)
        self.show: ShownPattern | None = None
        self._seen_lit: SceneState | None = None
        self._vibrating: tuple[SceneState, tuple[SceneState, ...]] | None = None
        self._draws: deque[int] = deque()
        self._count = 0  # of frames since opening

    def open(self) -> None:
        """Start with what the world has mounted, with the projector dark."""
        self.restart()
        with self._naming_file():
            self._check_device()
        self.check(self.world.mounted, 0)

    def restart(self) -> None:
        """Put everything back as it was after opening; see `fpplab.devices.simulation`."""
        self.setup, self.show = SceneState(self.world.mounted), None
        self._draws.clear()
        self._count = 0

    def check(self, item: str, pose: int) -> None:
        """Check that an item can be made, and seen in the projector's light."""
        if item != "nothing":
            with self._naming_file():
                self._check_lit(replace(self.setup, item=item, pose=pose))

    def poses(self) -> dict[str, tuple[RigidTransform, ...]]:
        with self._naming_file():
            return {name: item_poses(self.world, name) for name in self.world.items}

    def close(self) -> None:
        """End the Blender process and release every picture; allowed any number of times."""
        self.blender.close()
        self.light.forget()

    def replace_world(self, world: World) -> None:
        """Go on with another world and the same Blender process; pictures that are still valid are kept."""
        # For searches that change the response, the sensor or the light of the world many times.
        light = self._light_of(world)
        light.inherit(self.light)
        self.world, self.light, self._seen_lit, self._vibrating = world, light, None, None

    @contextmanager
    def _naming_file(self) -> Iterator[None]:
        """Name the file of a world that is refused: the modules that refuse it know it as "world" only."""
        try:
            yield
        except ConfigError as error:
            if not str(error).startswith(UNNAMED):
                raise
            raise ConfigError(f"{self._file}: {str(error).removeprefix(UNNAMED)}") from error

    def _light_of(self, world: World) -> Light:
        return Light(world, self.blender, analytic=self._analytic)

    def twin(self, board: str) -> Twin:
        """Make a twin that starts from this world and looks at one of its boards; see `sim.matching`."""
        # It renders in the same Blender process and lives as long.
        with self._naming_file():
            return Twin.of(self.world, board, self.blender)

    def draw(self, numbers: Iterable[int]) -> None:
        """Let noise and vibration of the next frames follow from these numbers and the world's seed."""
        # For comparisons with common random numbers; what is left of earlier numbers is discarded.
        self._draws = deque(numbers)

    @property
    def next_frame(self) -> int:
        """Number of the next frame, counted since opening; see `fpplab.devices.simulation`."""
        return self._count

    def number_frames(self, numbers: Sequence[int], then: int) -> None:
        """Give the next frames numbers, from which their noise and vibration follow."""
        self._draws, self._count = deque(numbers), then - len(numbers)

    def next_draw(self) -> int:
        """Take the number that the next frame's noise and vibration follow from."""
        count, self._count = self._count, self._count + 1
        return self._draws.popleft() if self._draws else count

    def turn(self, convergence_deg: float) -> None:
        self.setup = replace(self.setup, convergence_deg=float(convergence_deg))

    def image_part_sampler(self, world_draw: int = 0) -> ImagePartSampler:
        """Make a sampler of parts of the image, for predictions; see `fpplab.devices.simulation`."""
        world = self.world.drawn(world_draw)
        return ImagePartSampler(world, self.light if world is self.world else self._light_of(world))

    def studio(self) -> SimStudio:
        return SimStudio(self)

    def irradiance(self, settings: CameraSettings, frame: int) -> PatternLevels:
        # returns (height, width)
        setup, show = self._with_error_draw(self.setup), self.show
        if show is not None and setup.item != "nothing":
            with self._naming_file():
                self._check_lit(setup)
        random = np.random.default_rng([self.world.seed, frame])
        moved = displacement_mm(self.world, random, frame)
        weights, size_mm = self._row_weights(show, settings, random.uniform()), self.world.moves_mm
        if size_mm and setup.item != "nothing" and not self.light.computes(setup):
            steps = moved / size_mm
            picture = displaced_irradiance(self.light, setup, self._displaced(setup), steps, show, weights)
            return self._with_fluctuation(setup, picture, frame)
        if size_mm:  # computed light is exact for every displacement at no greater cost
            x, y, z = moved.tolist()
            setup = replace(setup, vibration_mm=(x, y, z))
        return self._with_fluctuation(setup, self.light.irradiance(setup, show, weights), frame)

    def _with_error_draw(self, setup: SceneState) -> SceneState:
        if setup.item == "nothing" or point_error_sizes(self.world) is None:
            return setup
        pose = setup.held or item_poses(self.world, setup.item)[setup.pose]
        return replace(setup, error_draw=error_draw(pose))

    def _with_fluctuation(self, setup: SceneState, picture: PatternLevels, frame: int) -> PatternLevels:
        changes = Fluctuation.of(self.world)
        return picture if changes is None else changes.in_whole_frames(self.light, setup)(picture, frame)

    def _displaced(self, setup: SceneState) -> tuple[SceneState, ...]:
        if self._vibrating is None or self._vibrating[0] != setup:
            pose = setup.held or item_poses(self.world, setup.item)[setup.pose]
            self._vibrating = (setup, displaced(setup, pose, self.world.moves_mm))
        return self._vibrating[1]

    def _row_weights(
        self, show: ShownPattern | None, settings: CameraSettings, start: float
    ) -> Floats | None:
        """Light of every binary plane in every row, where the exposure is not a whole number of periods."""
        period, shutter = self.world.projector.period_s, self.world.camera.shutter
        if show is None or period == 0 or is_whole(settings.exposure_s, period):
            return None
        rows, bits = self.world.camera.size[1], show.pattern.bit_depth
        return plane_weights(rows, bits, period, settings.exposure_s, shutter.line_time_s, start * period)

    def _check_device(self) -> None:
        """Render one pixel, where the computer may lack the render device that the world asks for."""
        if self.world.render.device == "CPU" or not self.world.items:
            return
        scene, _ = build_scene(self.world, SceneState(next(iter(self.world.items))))
        pixel = replace(scene, window=(0, 0, 1, 1))
        try:
            self.blender.render(
                pixel,
                None,
                [SubpixelView((0.0, 0.0))],
                RenderSettings(device=self.world.render.device),
                START_S,
            )
        except BaseException:
            self.blender.close()  # `close` is not called where `open` fails
            raise

    def _check_lit(self, setup: SceneState) -> None:
        if setup == self._seen_lit:
            return
        if not is_lit_in_view(self.world, setup):
            raise ConfigError(
                f"world: the camera sees nothing of the projector's light on '{setup.item}' "
                f"(pose {setup.pose}, stage at {setup.stage_mm:g} mm); correct "
                f"'items.{setup.item}' or 'projector.T_camera_projector'"
            )
        self._seen_lit = setup
