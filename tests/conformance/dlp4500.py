"""The reference rig with the LightCrafter's driver: the camera sees what the emulated controller shows."""

from collections import deque
from dataclasses import replace
from functools import cache

import numpy as np

from drivers.clock import SteppedClock
from drivers.dlp4500.index import FlashIndex, index_checksum
from drivers.dlp4500.sequence import SIZE, Slot
from drivers.emulators.dlpc350 import (
    STRICT,
    Dlpc350,
    EmulatedDisplay,
    EmulatedHid,
    FlashImage,
    ProjectedLight,
    Pulse,
)
from fpplab.core.conventions import Lattice
from fpplab.core.errors import DeviceTimeoutError
from fpplab.devices import Trigger
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.plan import Plan
from tests.conformance.bench import COLUMNS, FLAT, ROWS
from tests.conformance.reference import PROJECTOR_SIZE, ReferenceBench, ReferenceCamera
from tests.drivers.projector_bench import packed

FLASH = "flash.yaml"
FEWER_BITS = (1, 4, 7)
FRAME_S = 1 / 30
"""Of the video port: long enough for the plan's exposure and the camera's readout."""


@cache
def planned() -> list[Pattern]:
    """The patterns of the tests' plan."""
    return make_patterns(Plan(fringes=(FLAT, COLUMNS, ROWS)), SIZE, Lattice.DIAMOND)


@cache
def flash() -> tuple[list[FlashImage], FlashIndex]:
    """What the projector holds: the plan's, and a ramp of fewer bits."""
    ramp = planned()[FLAT.steps]
    return packed([*planned(), *(replace(ramp, bit_depth=bits) for bits in FEWER_BITS)])


def shown(light: ProjectedLight | None, index: FlashIndex) -> Pattern | None:
    """What is in the light, coarse as the reference camera sees it, and by the name it has in flash."""
    if light is None or light.image is None:
        return None
    slot = Slot(light.image, light.number, light.depth)
    name = next(pattern.id for pattern in index.patterns if pattern.slot == slot)
    return coarse(light, name)


def coarse(light: ProjectedLight, name: str) -> Pattern:
    """Light as the reference camera sees it."""
    width, height = PROJECTOR_SIZE
    columns, rows = np.arange(width) * SIZE[0] // width, np.arange(height) * SIZE[1] // height
    return Pattern(name, light.grey[np.ix_(rows, columns)])


class LightCrafterBench(ReferenceBench):
    """A reference bench lit by an emulated projector on the wire `hid`, in the time of `clock`."""

    def open(self) -> None:
        super().open()
        images, self.index = flash()
        self.clock = SteppedClock()
        self.controller = Dlpc350(self.clock, images, STRICT, self._pulsed)
        self.hid = EmulatedHid(self.controller)
        self.caught: deque[Pattern | None] = deque()

    def seen(self, light: ProjectedLight | None) -> Pattern | None:
        """What a camera sees of it."""
        return shown(light, self.index)

    def _pulsed(self, pulse: Pulse) -> None:
        if pulse.output == 1:
            self.caught.append(self.seen(self.controller.light_at(pulse.rise_s)))


class VideoBench(LightCrafterBench):
    """The same with a computer's `display` on the projector's video port."""

    def open(self) -> None:
        super().open()
        self.display = EmulatedDisplay(self.controller, FRAME_S)

    def seen(self, light: ProjectedLight | None) -> Pattern | None:
        """What a camera sees of it, by name where only one pattern of the plan looks so."""
        if light is None or light.image is None:
            return None
        sha256 = index_checksum(light.grey)
        names = [p.id for p in self.index.patterns if (p.bits, p.sha256) == (light.depth, sha256)]
        return coarse(light, names[0] if len(names) == 1 else "")


class WatchingCamera(ReferenceCamera):
    """Exposes on trigger output 1, or at once."""

    _bench: LightCrafterBench

    def _arm(self, n: int, trigger: Trigger) -> None:
        super()._arm(n, trigger)
        self._bench.caught.clear()

    def _exposed(self) -> Pattern | None:
        bench = self._bench
        if self._trigger == "software":
            return bench.seen(bench.controller.light())
        while not bench.caught:
            due = bench.controller.sequencer.next_s
            if due is None:
                raise DeviceTimeoutError(self.name, "read", "no trigger came", "see to the trigger cable")
            bench.clock.sleep(due - bench.clock.now())
            bench.controller.advance()
        return bench.caught.popleft()
