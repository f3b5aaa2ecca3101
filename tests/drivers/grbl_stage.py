"""An emulated GRBL stage for tests: driver, controller and the serial line between them."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from drivers.emulators.grbl import GrblController, GrblPolicy, Rail
from drivers.emulators.terminal import PseudoTerminal
from drivers.stage_grbl import GrblStage

PULL_OFF_MM, STEP_MM = 2.0, 1 / 400
"""Settings of the emulated controller."""


class Bench:
    """A stage on a pseudo-terminal, on a clock that runs faster than the real one."""

    def __init__(
        self,
        settings: dict[int, float] | None = None,
        times: float = 200.0,
        policy: GrblPolicy | None = None,
        rail: Rail | None = None,
    ) -> None:
        self.controller = GrblController(lambda: times * time.monotonic(), settings, rail, policy)
        self.terminal = PseudoTerminal(self.controller)
        self.said: list[str] = []
        self.heard = bytearray()
        receive = self.controller.receive
        self.controller.receive = lambda data: (self.heard.extend(data), receive(data))[1]  # type: ignore[method-assign]

    def __enter__(self) -> Bench:
        self.terminal.__enter__()
        self.stage = GrblStage("stage", {"port": self.terminal.port})
        return self

    def __exit__(self, *_: Any) -> None:
        try:
            self.stage.close()
        finally:
            self.terminal.__exit__(None, None, None)

    def homed(self) -> GrblStage:
        """Open and home the stage."""
        self.stage.open()
        self.stage.home()
        return self.stage

    def at_mm(self, mm: float, action: Callable[[], None]) -> None:
        """Call a function when a motion passes `mm` of the stage."""
        self.controller.drive.call_at(-PULL_OFF_MM - mm, action)

    def type(self, data: bytes) -> None:
        """Send bytes as another program that also reads the answers."""
        with self.terminal.lock:
            self.controller.receive(data)
            self.controller.poll()

    def jog(self, target_mm: float) -> None:
        """Jog to a machine position at 20 mm/s, as another program does."""
        with self.terminal.lock:
            self.controller.jog(target_mm, 20.0)

    def alter_line(self, old: str, new: str) -> None:
        """Replace text in all that the controller sends from now on."""
        self.controller.alter_line = lambda line: line.replace(old, new)


class VirtualTime:
    """Stands in for the module `time`."""

    def __init__(self, clock: list[float]) -> None:
        self._clock = clock

    def monotonic(self) -> float:
        return self._clock[0]

    def sleep(self, seconds: float) -> None:
        self._clock[0] += seconds


class DirectLine:
    """Stands in for `serial.Serial`: no serial line, and time passes only during a wait."""

    def __init__(self, controller: GrblController, clock: list[float]) -> None:
        self._controller, self._clock, self._data = controller, clock, b""
        self.timeout = 0.0

    def __call__(self, *_: Any, **__: Any) -> DirectLine:
        return self

    @property
    def in_waiting(self) -> int:
        return len(self._data)

    def read(self, count: int) -> bytes:
        self._data += self._controller.poll()
        if not self._data:
            self._clock[0] += self.timeout
            self._data += self._controller.poll()
        taken, self._data = self._data[:count], self._data[count:]
        return taken

    def write(self, data: bytes) -> None:
        self._controller.receive(data)

    def open(self) -> None:
        """There is nothing to open, nor to close."""

    close = open
