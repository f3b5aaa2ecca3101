"""The emulated bench: the real drivers connected to emulators, with another rig in place of the optics.

The emulated projector determines which pattern illuminates the scene, its trigger output 1 triggers the
emulated camera on Line1, and the rig given as `optics` (a simulation, for instance) renders the image. The
bench's time passes only while a driver waits for something, so that timing does not depend on the
computer's load. `configs/rig_emulated.yaml` is one. It tests the drivers, not a real board or camera.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from drivers.dlp4500.sequence import pattern_numbers
from drivers.emulators.bench_camera import BenchPylon
from drivers.emulators.dlpc350 import STRICT as STRICT_BOARD
from drivers.emulators.dlpc350 import (
    Dlpc350,
    Dlpc350Policy,
    EmulatedDisplay,
    EmulatedHid,
    FlashedDlpc350,
    ProjectedLight,
    Pulse,
    UsbFault,
)
from drivers.emulators.exposure import (
    STRICT,
    BenchClock,
    CollectedLight,
    EmulatedShutter,
    SensorTiming,
    mean_pattern,
)
from drivers.emulators.grbl import GrblController, Rail
from drivers.emulators.grbl.drive import DEFAULTS
from drivers.emulators.optics import GreyImage, OpticsRig
from drivers.emulators.terminal import PseudoTerminal
from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Image
from fpplab.core.errors import ConfigError, SettingError
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings, DeviceInfo, FixtureCaps, PosableFixture
from fpplab.devices.backends import load_backend
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import NumberedFrames, Restartable

STAGE_SPEEDUP = 100.0  # factor by which the emulated stage's time runs faster than real time (chosen)

FaultCount = Annotated[int, Field(ge=0)]  # an index or number from 0


class BenchFaults(Document):
    """Faults to provoke, for training and tests; numbers count from 0."""

    missed: tuple[FaultCount, ...] = ()
    """Trigger pulses since the camera was armed that do not arrive."""
    doubled: tuple[FaultCount, ...] = ()
    """Trigger pulses since the camera was armed that give two frames."""
    cut: bool = False
    """Whether the trigger cable is cut, so that no pulse arrives."""
    extra: bool = False
    """Whether there is an extra trigger pulse, one exposure before the first."""
    dropped: tuple[FaultCount, ...] = ()
    """Requests to the projector since the bench was opened whose replies are lost."""
    late: tuple[FaultCount, ...] = ()
    """Requests to the projector since the bench was opened whose replies are late."""
    unplug_projector: FaultCount | None = None
    """Request to the projector at which its cable is unplugged."""
    unplug_camera: FaultCount | None = None
    """Number of exposures after which the camera's cable is unplugged."""

    def reply_faults(self) -> dict[int, UsbFault]:
        faults = dict.fromkeys(self.dropped, UsbFault.DROP) | dict.fromkeys(self.late, UsbFault.LATE)
        if self.unplug_projector is not None:
            faults[self.unplug_projector] = UsbFault.UNPLUG_BEFORE
        return faults


class EmulatedBenchOptions(Document):
    """The section `bench` of a rig file with an emulated bench."""

    optics: str
    """Rig file of the rig that renders the images."""
    firmware: str | None = None
    """File with the content of the projector's flash, from `fpplab dlp4500 build`."""
    refresh_hz: Annotated[float, Field(ge=10, le=120)] = 60.0
    """Refresh rate in Hz of the display on the projector's video port."""
    sensor: SensorTiming = STRICT
    """How soon the camera takes the next trigger pulse."""
    board: Literal["strict", "lenient"] = "strict"
    """Whether the projector ignores the first start, shows late that it runs and takes time for each request;
    a lenient one does none of these."""
    faults: BenchFaults = BenchFaults()
    """Faults to provoke."""


class EmulatedBench:
    """What the drivers of a rig find in place of their devices."""

    def __init__(self, options: dict[str, Any]) -> None:
        chosen = config.validate(options, EmulatedBenchOptions, "bench")
        self.faults = chosen.faults
        self._options = chosen
        self._stack = ExitStack()

    def open(self) -> None:
        """Open the optics and connect all devices; the projector is dark, the stage at the optics' 0."""
        optics_rig = Rig.load(self._options.optics)
        if optics_rig.file.bench is not None and issubclass(
            load_backend(optics_rig.file.bench.backend, optics_rig.source, "bench"), EmulatedBench
        ):
            raise ConfigError(
                f"bench: 'optics' is '{self._options.optics}': must not be an emulated bench itself"
            )
        with ExitStack() as stack:
            self.optics_rig = stack.enter_context(optics_rig)
            self._check_optics()
            self.optics = OpticsRig(self.optics_rig)
            self._make_projector()
            self.shutter, self._exposures = EmulatedShutter(self.clock, self._options.sensor), 0
            bayer = self.optics_rig.camera.caps.bayer
            self.pylon = BenchPylon(self.optics.size, self.shutter, self._render, self._options.sensor, bayer)
            self.shutter.on_strobe = self._on_strobe
            self.pylon.start()
            stack.callback(self.pylon.close)
            self.terminal = self._make_stage(stack)
            self.stage_port = self.terminal.port if self.terminal else None
            self._stack = stack.pop_all()

    def close(self) -> None:
        self._stack.close()

    def now_s(self) -> float:
        """Give the bench's time in s."""
        return self.clock.now()

    @property
    def next_frame(self) -> int:
        """Number of the next frame that the optics render; see `fpplab.devices.simulation`."""
        optics = self.optics_rig.simulation
        return optics.next_frame if isinstance(optics, NumberedFrames) else 0

    def number_frames(self, numbers: Sequence[int], then: int) -> None:
        """Give the next frames that the optics render numbers, from which their noise follows."""
        if isinstance(self.optics_rig.simulation, NumberedFrames):
            self.optics_rig.simulation.number_frames(numbers, then)

    def restart(self) -> None:
        """Put the optics back as they were after opening; the stage stays where it is."""
        stage = self.optics_rig.stage
        stage_mm = stage.position_mm if stage is not None and stage.homed else 0.0
        if isinstance(self.optics_rig.simulation, Restartable):
            self.optics_rig.simulation.restart()
        if stage is not None and stage_mm:
            stage.move_to(stage_mm)

    def _check_optics(self) -> None:
        depths = self.optics_rig.projector.caps.bit_depths
        if 8 not in depths:
            raise ConfigError(
                f"bench: 'optics' is '{self._options.optics}': needs a projector that shows 8 bits; "
                f"that one shows {sorted(depths)}"
            )

    def _make_projector(self) -> None:
        self.clock = BenchClock()
        policy = STRICT_BOARD if self._options.board == "strict" else Dlpc350Policy()
        if self._options.firmware is None:
            self.controller = Dlpc350(self.clock, [], policy, on_pulse=self._on_pulse)
        else:
            content = _read_firmware(Path(self._options.firmware))
            self.controller = FlashedDlpc350(self.clock, content, policy, on_pulse=self._on_pulse)
        self.clock.controller = self.controller
        self.hid = EmulatedHid(self.controller, faults=self.faults.reply_faults())
        self.display = EmulatedDisplay(self.controller, 1 / self._options.refresh_hz)

    def _make_stage(self, stack: ExitStack) -> PseudoTerminal | None:
        """Make a stage with the travel of the optics' one; homing ends at the 0 of the optics."""
        if self.optics_rig.stage is None:
            return None
        _, far_mm = self.optics_rig.stage.caps.travel_mm
        pull_off_mm = DEFAULTS[27]
        travel_mm = far_mm + pull_off_mm
        self.grbl = GrblController(
            lambda: STAGE_SPEEDUP * time.monotonic(),
            {130: travel_mm},
            Rail(length_mm=travel_mm + 5.0, start_mm=pull_off_mm),
        )
        return stack.enter_context(PseudoTerminal(self.grbl))

    # --- light

    def _render(self, settings: CameraSettings, collected: CollectedLight) -> Image:
        """Render the image of what a shutter collected; the camera's cable may be unplugged after it."""
        self._update_stage()
        light = collected[0][0] if len(collected) == 1 else None
        image = self.optics.capture(settings, mean_pattern(collected), lambda: self._related_patterns(light))
        self._exposures += 1
        if self._exposures == self.faults.unplug_camera:
            self.pylon.unplug()
        return image

    def _update_stage(self) -> None:
        if self.terminal is not None:
            with self.terminal.lock:
                carriage_mm = self.grbl.drive.carriage_mm
            # To 0.1 µm: the rounding of steps would move the optics' stage for nothing.
            self.optics.move_stage(round(carriage_mm - DEFAULTS[27], 4))

    def _related_patterns(self, light: ProjectedLight | None) -> Iterator[GreyImage]:
        """Yield the patterns of the same kind that are in flash, or in the same video frame."""
        if light is None or light.image is None:
            return
        stored = any(light.content is image for image in self.controller.images)
        for content in self.controller.images if stored else [light.content]:
            for number in pattern_numbers(light.depth):
                related = ProjectedLight(
                    content, light.depth, number, light.inverted, light.levels, light.image
                )
                greys = mean_pattern([(related, 1.0)])
                assert greys is not None
                yield greys

    # --- the trigger cables

    def _on_strobe(self, active: bool) -> None:
        """Carry the camera's output to the projector's trigger input 1, if one is active while it exposes."""
        if self.pylon.has_strobe() and not self.faults.cut:
            self.controller.trigger_in(1, active)

    def _on_pulse(self, pulse: Pulse) -> None:
        if pulse.output != 1:
            return
        edges = (pulse.rise_s, pulse.fall_s)
        rise_s, fall_s = edges[::-1] if self.controller.inverts_output_1 else edges
        camera = self.pylon.armed_camera()
        if camera is None or self.faults.cut:
            return
        number, camera.pulses = camera.pulses, camera.pulses + 1
        settings, at_s = camera.settings(), camera.exposure_start_s(rise_s, fall_s)
        if self.faults.extra and number == 0:
            self.shutter.open(settings, at_s - self._options.sensor.period_s(settings.exposure_s))
        if number not in self.faults.missed:
            self.shutter.open(settings, at_s, times=1 + (number in self.faults.doubled))


class EmulatedFixture(PosableFixture):
    """The fixture of the optics."""

    def _setup(self, options: dict[str, Any], shared: Any) -> None:
        super()._setup(options, shared)
        if not isinstance(shared, EmulatedBench):
            raise ConfigError(f"{self.name}: needs the bench 'emulated_bench' in the rig file")
        self._bench = shared

    @property
    def bench(self) -> EmulatedBench:
        """The emulated bench that it is part of, for tests that inspect the emulators."""
        return self._bench

    def _open(self) -> None:
        self._optics_fixture = self._bench.optics_rig.need_fixture("the rig on it")

    def _close(self) -> None:
        """Leave the item mounted."""

    def _info(self) -> DeviceInfo:
        return self._optics_fixture.info()

    def _caps(self) -> FixtureCaps:
        return self._optics_fixture.caps

    def _check(self, item: str, pose: int) -> None:
        self._optics_fixture.check(item, pose)

    def _mount(self, item: str, pose: int) -> None:
        self._optics_fixture.mount(item, pose)

    def _place(self, item: str, T_camera_item: RigidTransform) -> None:
        if not isinstance(self._optics_fixture, PosableFixture):
            raise SettingError(self.name, "place", "the fixture of the optics has fixed poses alone")
        self._optics_fixture.place(item, T_camera_item)

    def _pose(self, item: str, pose: int) -> RigidTransform | None:
        return self._optics_fixture.pose(item, pose)


def _read_firmware(firmware: Path) -> bytes:
    try:
        return firmware.read_bytes()
    except OSError as error:
        raise ConfigError(f"bench: 'firmware' is '{firmware}': cannot be read ({error.strerror})") from error
