"""The reference rig with the LightCrafter's driver: the camera sees what the emulated controller shows."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from functools import cache

import numpy as np

from drivers.clock import SteppedClock
from drivers.dlp4500.index import FlashIndex
from drivers.dlp4500.sequence import SIZE, Slot
from drivers.emulators.dlpc350 import Dlpc350, EmulatedHid, FlashImage, Light, Pulse
from fpplab.conventions import Lattice
from fpplab.devices import Trigger
from fpplab.errors import TimeoutError
from fpplab.patterns import Pattern, make_patterns
from fpplab.plan import Plan
from tests.conformance.bench import COLUMNS, FLAT, ROWS
from tests.conformance.reference import PROJECTOR_SIZE, ReferenceBench, ReferenceCamera
from tests.drivers.projector_bench import packed

FLASH = "flash.yaml"
FEWER_BITS = (1, 4, 7)


@cache
def flash() -> tuple[list[FlashImage], FlashIndex]:
    """What the projector holds: the patterns of the tests' plan, and a ramp of fewer bits."""
    patterns = make_patterns(Plan(fringes=(FLAT, COLUMNS, ROWS)), SIZE, Lattice.DIAMOND)
    ramp = patterns[FLAT.steps]
    return packed([*patterns, *(replace(ramp, bit_depth=bits) for bits in FEWER_BITS)])


class LightCrafterBench(ReferenceBench):
    """A reference bench lit by an emulated projector on the wire `hid`, in the time of `clock`."""

    def open(self) -> None:
        super().open()
        images, self.index = flash()
        self.clock = SteppedClock()
        self.controller = Dlpc350(self.clock, images, on_pulse=self._pulsed)
        self.hid = EmulatedHid(self.controller)
        self.caught: deque[Pattern | None] = deque()

    def shown(self, light: Light | None) -> Pattern | None:
        """What is in the light, coarse as the reference camera sees it, and by the name it has in flash."""
        if light is None or light.image is None:
            return None
        slot = Slot(light.image, light.number, light.depth)
        name = next(pattern.id for pattern in self.index.patterns if pattern.slot == slot)
        width, height = PROJECTOR_SIZE
        columns, rows = np.arange(width) * SIZE[0] // width, np.arange(height) * SIZE[1] // height
        return Pattern(name, light.grey[np.ix_(rows, columns)])

    def _pulsed(self, pulse: Pulse) -> None:
        if pulse.output == 1:
            self.caught.append(self.shown(self.controller.light_at(pulse.rise_s)))


class WatchingCamera(ReferenceCamera):
    """Exposes on trigger output 1, or at once."""

    _bench: LightCrafterBench

    def _arm(self, n: int, trigger: Trigger) -> None:
        super()._arm(n, trigger)
        self._bench.caught.clear()

    def _exposed(self) -> Pattern | None:
        bench = self._bench
        if self._trigger == "software":
            return bench.shown(bench.controller.light())
        while not bench.caught:
            due = bench.controller.sequencer.next_s
            if due is None:
                raise TimeoutError(self.name, "read", "no trigger came", "see to the trigger cable")
            bench.clock.sleep(due - bench.clock.now())
            bench.controller.advance()
        return bench.caught.popleft()
