"""The four devices of a rig over one simulated world, see `sim.bench`."""

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.errors import ConfigError, SettingError
from fpplab.core.geometry import RigidTransform
from fpplab.devices import (
    Camera,
    CameraCaps,
    CameraSettings,
    DeviceInfo,
    FixtureCaps,
    Frame,
    PosableFixture,
    Projector,
    ProjectorCaps,
    Stage,
    StageCaps,
    Trigger,
)
from fpplab.patterns.fringes import Pattern, quantise
from sim.bench import VirtualBench
from sim.build import is_lit_in_view
from sim.light import ShownPattern
from sim.sensor import SensorModel, colour_shares
from sim.world import BoardItem

SERIAL = "simulated"
"""Serial number of camera and projector. As those of instruments it says nothing of the world's geometry:
whether a calibration still holds has to be seen in the frames."""

MIN_EXPOSURE_S = {
    1: 235e-6, 2: 700e-6, 3: 1570e-6, 4: 1700e-6, 5: 2000e-6, 6: 2500e-6, 7: 4500e-6, 8: 8333e-6,
}  # fmt: skip
"""Least pattern exposure by bit depth, as of the DLP LightCrafter 4500 that the projector stands in for."""


def _shared(bench: Any, name: str, options: dict[str, Any]) -> VirtualBench:
    if not isinstance(bench, VirtualBench):
        raise ConfigError(f"{name}: needs the bench 'virtual_bench' in the rig file")
    if options:
        raise ConfigError(f"{name}: has no option '{next(iter(options))}'; the world file describes it")
    return bench


class SimCamera(Camera):
    """The world's camera. Like a real one it does not know which pattern is on show."""

    @property
    def bench(self) -> VirtualBench:
        """The virtual bench that it belongs to, which knows the ground truth."""
        return self._bench

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        self._bench = _shared(bench, self.name, options)

    def _open(self) -> None:
        self._index = 0
        self._clock_s = 0.0
        self._bench.number_frames((), then=0)

    def _close(self) -> None:
        """Nothing to make safe."""

    def _info(self) -> DeviceInfo:
        return DeviceInfo("camera", "simulated", SERIAL, "Blender")

    def _caps(self) -> CameraCaps:
        camera = self._bench.world.camera
        sensor = camera.sensor
        ranges = tuple(sensor.bits), sensor.exposure_s, sensor.gain_db
        bayer = camera.bayer.pattern if camera.bayer else None
        return CameraCaps(camera.size, *ranges, ("software",), offset=(0, 0), bayer=bayer)

    def _configure(self, settings: CameraSettings) -> CameraSettings:
        return settings

    def _arm(self, n: int, trigger: Trigger) -> None:
        self._index = 0  # a software trigger is the call of `read` itself

    def _read(self, timeout_s: float) -> Frame:
        # On the simulated clock a picture takes no longer than its exposure, however long Blender works.
        settings, world = self._configured("read"), self._bench.world
        number = self._bench.next_draw()
        led = self._bench.show.pattern.led if self._bench.show else None
        shares = colour_shares(world, self._bench.setup.item, led)
        light = self._bench.irradiance(settings, number) * shares
        image = SensorModel.of(world).expose(light, settings, number)
        index, self._index = self._index, self._index + 1
        self._clock_s += settings.exposure_s
        return Frame(image, index, settings, time.time(), self._clock_s)

    def _stop(self) -> None:
        """Nothing is under way between calls."""


def _shown(pattern: Pattern) -> Pattern:
    return replace(pattern, image=_greys(pattern.bit_depth)[pattern.image])


@lru_cache(maxsize=8)
def _greys(bit_depth: int) -> NDArray[np.uint8]:
    """Tabulate the grey level that a pattern of that bit depth shows for each of 256."""
    return quantise(np.arange(256) / 255.0, bit_depth)


# A read-only image need not be quantised twice; for the same pattern `Light` finds its pictures again.
_shown_again = lru_cache(maxsize=128)(_shown)


class SimProjector(Projector):
    """The world's projector. It has no trigger output yet, so it shows patterns one by one."""

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        self._bench = _shared(bench, self.name, options)

    def _open(self) -> None:
        self._bench.show = None
        self._loaded = ()

    def _close(self) -> None:
        self._bench.show = None

    def _info(self) -> DeviceInfo:
        projector = self._bench.world.projector
        return DeviceInfo("projector", f"simulated, {projector.lattice} lattice", SERIAL, "Blender")

    def _caps(self) -> ProjectorCaps:
        projector = self._bench.world.projector
        return ProjectorCaps(
            projector.size,
            projector.lattice,
            MIN_EXPOSURE_S,
            0,
            1000,
            period_s=projector.period_s,
            leds=tuple(projector.leds),
        )

    def _load(self, patterns: Sequence[Pattern]) -> Sequence[Pattern]:
        self._bench.show = None
        return [_shown(p) if p.image.flags.writeable else _shown_again(p) for p in patterns]

    def _show(self, i: int) -> None:
        self._bench.show = ShownPattern(self._loaded, i)

    def _play(self, exposure_s: float, dark_s: float, period_s: float) -> None:
        raise AssertionError("refused before: there is no trigger output")

    def _blank(self) -> None:
        self._bench.show = None


class SimStage(Stage):
    """Carries the projector along the baseline; homing ends at 0, where the world file's pose holds."""

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        self._bench = _shared(bench, self.name, options)

    def _open(self) -> None:
        self._homed = False

    def _close(self) -> None:
        """Nothing to do: the stage stands still between calls."""

    def _info(self) -> DeviceInfo:
        return DeviceInfo("stage", "simulated", "", "Blender")

    def _caps(self) -> StageCaps:
        return StageCaps(self._bench.world.stage.travel_mm)

    def _home(self) -> None:
        self._place(0.0)

    def _move_to(self, mm: float, deadline_s: float) -> None:
        self._place(mm)

    def _position_mm(self) -> float:
        return self._bench.setup.stage_mm

    def _halt(self) -> None:
        """Nothing to do: the stage stands still between calls."""

    def _place(self, mm: float) -> None:
        self._bench.setup = replace(self._bench.setup, stage_mm=float(mm))


class SimFixture(PosableFixture):
    """Holds the world's items, knows their poses, and puts a board into any other."""

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        self._bench = _shared(bench, self.name, options)

    def _open(self) -> None:
        self._held = self._bench.poses()

    def _close(self) -> None:
        """Nothing to do: the item stays mounted."""

    def _info(self) -> DeviceInfo:
        boards = sum(isinstance(item, BoardItem) for item in self._bench.world.items.values())
        return DeviceInfo("fixture", f"simulated, {len(self._held)} items, {boards} boards", "", "Blender")

    def _caps(self) -> FixtureCaps:
        return FixtureCaps({name: len(poses) for name, poses in self._held.items()})

    def _check(self, item: str, pose: int) -> None:
        self._bench.check(item, pose)

    def _mount(self, item: str, pose: int) -> None:
        self._bench.setup = replace(self._bench.setup, item=item, pose=pose, held=None)

    def _place(self, item: str, T_camera_item: RigidTransform) -> None:
        placed = replace(self._bench.setup, item=item, pose=0, held=T_camera_item)
        if not is_lit_in_view(self._bench.world, placed):
            raise SettingError(self.name, "place", f"nothing of {item} would be lit and seen there")
        self._bench.setup = placed

    def _pose(self, item: str, pose: int) -> RigidTransform:
        return self._held[item][pose]
