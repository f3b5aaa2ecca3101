"""The emulated bench: the real drivers on emulated wires, in the light of another rig.

    bench:     {backend: "drivers.emulators.bench:EmulatedBench", optics: rig_demo.yaml}
    camera:    {backend: "drivers.basler:BaslerCamera", serial: "0815-0000", roi: [0, 0, 1368, 912]}
    projector: {backend: "drivers.dlp4500:Dlp4500", video: {display: 0}}
    stage:     {backend: "drivers.stage_grbl:GrblStage"}
    fixture:   {backend: "drivers.emulators.bench:EmulatedFixture"}

The emulated projector decides which pattern lights the scene, its trigger output 1 fires the emulated camera
on Line1, and the rig called `optics` (a virtual bench, say) gives the picture. Bench time passes only while
somebody waits for something, so that nothing is early or late by what the computer is doing.

What is rehearsed here is proven for the drivers, not for a board or a camera.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from drivers.dlp4500.sequence import pattern_numbers
from drivers.emulators.bench_camera import BenchPylon
from drivers.emulators.dlpc350 import (
    Dlpc350,
    EmulatedDisplay,
    EmulatedHid,
    FlashedDlpc350,
    ProjectedLight,
    Pulse,
    UsbFault,
)
from drivers.emulators.exposure import BenchClock, Collected, EmulatedShutter, mean
from drivers.emulators.grbl import GrblController, Rail
from drivers.emulators.grbl.settings import DEFAULTS
from drivers.emulators.optics import GreyImage, RigInPlaceOfOptics
from drivers.emulators.terminal import Terminal
from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Image
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings, DeviceInfo, Fixture, FixtureCaps
from fpplab.devices.rig import Rig

STAGE_TIMES_FASTER = 100.0
STAGE_DIGITS = 4
"""Of the carriage's position in mm that count: a tenth of a micrometre."""

FaultCount = Annotated[int, Field(ge=0)]


class Faults(Document):
    """What goes wrong, for training and tests; numbers count from 0.

    missed, doubled: pulses on the trigger cable since the camera was armed that do not come, or fire two
    frames. extra: a pulse more, one exposure before the first. dropped, late: the projector's replies, by
    requests since the bench was opened. unplug_projector: at that request. unplug_camera: after so many
    exposures.
    """

    missed: tuple[FaultCount, ...] = ()
    doubled: tuple[FaultCount, ...] = ()
    extra: bool = False
    dropped: tuple[FaultCount, ...] = ()
    late: tuple[FaultCount, ...] = ()
    unplug_projector: FaultCount | None = None
    unplug_camera: FaultCount | None = None

    def of_replies(self) -> dict[int, UsbFault]:
        """As the emulated wire takes them."""
        faults = dict.fromkeys(self.dropped, UsbFault.DROP) | dict.fromkeys(self.late, UsbFault.LATE)
        if self.unplug_projector is not None:
            faults[self.unplug_projector] = UsbFault.UNPLUG_BEFORE
        return faults


class EmulatedBenchOptions(Document):
    """The bench's section in a rig file.

    optics: the rig file that gives the pictures. firmware: what is in the projector's flash, from
    `fpplab dlp4500 build`. refresh_hz: of the display on its video port.
    """

    optics: str
    firmware: str | None = None
    refresh_hz: Annotated[float, Field(ge=10, le=120)] = 60.0
    faults: Faults = Faults()


class EmulatedBench:
    """What the drivers find at the far end of their wires: `pylon`, `hid`, `display`, `clock`, `stage_port`.

    controller: the projector's. terminal: the stage's end of its line, where the optics have a stage.
    faults: those of the trigger cable may be changed at any time. Raises `ConfigError` for wrong options.
    """

    def __init__(self, options: dict[str, Any]) -> None:
        chosen = config.validate(options, EmulatedBenchOptions, "bench")
        self.faults = chosen.faults
        self._options = chosen
        self._stack = ExitStack()

    def open(self) -> None:
        """Open the optics and connect everything: dark, the stage where the optics have it at 0."""
        inner = Rig.load(self._options.optics)
        if inner.file.bench is not None and inner.file.bench.backend.startswith(__name__):
            raise ConfigError(f"bench: 'optics' is '{self._options.optics}': an emulated bench itself")
        with ExitStack() as stack:
            self.inner = stack.enter_context(inner)
            self._check_optics()
            self.optics = RigInPlaceOfOptics(self.inner)
            self._make_projector()
            self.shutter, self._exposures = EmulatedShutter(self.clock), 0
            self.pylon = BenchPylon(self.optics.size, self.shutter, self._seen)
            self.pylon.start()
            stack.callback(self.pylon.close)
            self.terminal = self._make_stage(stack)
            self.stage_port = self.terminal.port if self.terminal else None
            self._stack = stack.pop_all()

    def close(self) -> None:
        """Let go of the optics and of every wire."""
        self._stack.close()

    def _check_optics(self) -> None:
        depths = self.inner.projector.caps.bit_depths
        if 8 not in depths:
            raise ConfigError(
                f"bench: 'optics' is '{self._options.optics}': needs a projector of 8 bits; "
                f"that one shows {sorted(depths)}"
            )

    def _make_projector(self) -> None:
        self.clock = BenchClock()
        if self._options.firmware is None:
            self.controller = Dlpc350(self.clock, [], on_pulse=self._pulsed)
        else:
            content = _content(Path(self._options.firmware))
            self.controller = FlashedDlpc350(self.clock, content, on_pulse=self._pulsed)
        self.clock.controller = self.controller
        self.hid = EmulatedHid(self.controller, faults=self.faults.of_replies())
        self.display = EmulatedDisplay(self.controller, 1 / self._options.refresh_hz)

    def _make_stage(self, stack: ExitStack) -> Terminal | None:
        """A stage that goes from the optics' 0, where homing ends, as far as theirs does."""
        if self.inner.stage is None:
            return None
        _, far_mm = self.inner.stage.caps.travel_mm
        pull_off_mm = DEFAULTS[27]
        travel_mm = far_mm + pull_off_mm
        self.grbl = GrblController(
            lambda: STAGE_TIMES_FASTER * time.monotonic(),
            {130: travel_mm},
            Rail(length_mm=travel_mm + 5.0, start_mm=pull_off_mm),
        )
        return stack.enter_context(Terminal(self.grbl))

    # --- light

    def _seen(self, settings: CameraSettings, collected: Collected) -> Image:
        """The picture of what a shutter collected; the camera's cable may be pulled after it."""
        self._place_stage()
        light = collected[0][0] if len(collected) == 1 else None
        picture = self.optics.picture(settings, mean(collected), lambda: self._together(light))
        self._exposures += 1
        if self._exposures == self.faults.unplug_camera:
            self.pylon.unplug()
        return picture

    def _place_stage(self) -> None:
        if self.terminal is not None:
            with self.terminal.lock:
                carriage_mm = self.grbl.drive.carriage_mm
            self.optics.place(round(carriage_mm - DEFAULTS[27], STAGE_DIGITS))

    def _together(self, light: ProjectedLight | None) -> Iterator[GreyImage]:
        """The patterns of equal kind that are in flash, or in the same video frame."""
        if light is None or light.image is None:
            return
        stored = any(light.content is image for image in self.controller.images)
        for content in self.controller.images if stored else [light.content]:
            for number in pattern_numbers(light.depth):
                alike = ProjectedLight(
                    content, light.depth, number, light.inverted, light.levels, light.image
                )
                greys = mean([(alike, 1.0)])
                assert greys is not None
                yield greys

    # --- the trigger cable

    def _pulsed(self, pulse: Pulse) -> None:
        if pulse.output != 1:
            return
        edges = (pulse.rise_s, pulse.fall_s)
        rise_s, fall_s = edges[::-1] if self.controller.inverts_output_1 else edges
        camera = self.pylon.listener()
        if camera is None:
            return
        number, camera.pulses = camera.pulses, camera.pulses + 1
        settings, at_s = camera.settings(), camera.fired_s(rise_s, fall_s)
        if self.faults.extra and number == 0:
            self.shutter.open(settings, at_s - settings.exposure_s)
        if number not in self.faults.missed:
            self.shutter.open(settings, at_s, times=1 + (number in self.faults.doubled))


class EmulatedFixture(Fixture):
    """The fixture of the optics."""

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        super()._setup(options, bench)
        if not isinstance(bench, EmulatedBench):
            raise ConfigError(f"{self.name}: needs the bench '{__name__}:EmulatedBench' in the rig file")
        self._bench = bench

    @property
    def bench(self) -> EmulatedBench:
        """What it is part of, for those who want to look behind the wires."""
        return self._bench

    def _open(self) -> None:
        self._held_by = self._bench.inner.need_fixture("the rig on it")

    def _close(self) -> None:
        """It goes on holding what it holds."""

    def _info(self) -> DeviceInfo:
        return self._held_by.info()

    def _caps(self) -> FixtureCaps:
        return self._held_by.caps

    def _check(self, item: str, pose: int) -> None:
        self._held_by.check(item, pose)

    def _mount(self, item: str, pose: int) -> None:
        self._held_by.mount(item, pose)

    def _pose(self, item: str, pose: int) -> RigidTransform | None:
        return self._held_by.pose(item, pose)


def _content(firmware: Path) -> bytes:
    try:
        return firmware.read_bytes()
    except OSError as error:
        raise ConfigError(f"bench: 'firmware' is '{firmware}': cannot be read ({error.strerror})") from error
