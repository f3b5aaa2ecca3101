"""The reference rig with a fault in its timing, and a camera that does not know what it saw, as real ones.

bench: {backend: "tests.conformance.slipping:SlippingBench", latency_s: 0.015}
bench: {backend: "tests.conformance.slipping:SlippingBench", cause: missed, frame: 5}
"""

from collections import deque
from dataclasses import replace

from drivers.clock import SteppedClock
from fpplab.acquisition.synchronisation import Cause, SyncFault
from fpplab.devices import Frame
from fpplab.patterns.fringes import Pattern
from tests.conformance.reference import ReferenceBench, ReferenceCamera, ReferenceProjector

CLOCK = SteppedClock()
"""The time of these benches: a settling time passes on it, and the camera's exposures."""


class SlippingBench(ReferenceBench):
    """Light follows what is shown `latency_s` later; triggers slip by one of the causes, at a frame."""

    def open(self) -> None:
        self._queue: deque[tuple[float, Pattern | None]] = deque([(CLOCK.now(), None)])
        super().open()

    @property
    def on_show(self) -> Pattern | None:
        """What lights the scene now."""
        while len(self._queue) > 1 and self._queue[1][0] <= CLOCK.now():
            self._queue.popleft()
        return self._queue[0][1]

    @on_show.setter
    def on_show(self, pattern: Pattern | None) -> None:
        self._queue.append((CLOCK.now() + self.options.get("latency_s", 0.0), pattern))

    def exposed(self, played: list[Pattern]) -> list[Pattern | None]:
        """What is on at each trigger that reaches the camera."""
        if "cause" not in self.options:
            return list(played)
        fault = SyncFault(Cause(self.options["cause"]), self.options.get("frame", 0))
        return [None if k is None else played[k] for k in fault.shown(len(played))]


class BlindCamera(ReferenceCamera):
    """Exposes for as long as it is told, and does not say which pattern was on."""

    def _read(self, timeout_s: float) -> Frame:
        frame = replace(super()._read(timeout_s), pattern_id=None)
        CLOCK.sleep(frame.settings.exposure_s)
        return frame


class SlippingProjector(ReferenceProjector):
    """Plays with the bench's slips."""

    _bench: SlippingBench

    def _play(self, exposure_s: float, dark_s: float, period_s: float) -> None:
        self._bench.pulses.extend(self._bench.exposed(self._held))  # type: ignore[arg-type]
