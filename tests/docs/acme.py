"""The SDK of an imaginary maker of cameras, as small and as awkward as real ones: the camera of the how-to.

Its sensor looks at the reference rig of the conformance suite, or at a dark room without an `AcmeBench`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.patterns.fringes import Pattern
from tests.conformance.reference import CAMERA_SIZE, REFERENCE_EXPOSURE_S, ReferenceBench

RANGES = {"exposure_us": (100.0, 1e6), "gain_db": (0.0, 12.0), "bits": (8.0, 12.0)}
STEPS = {"exposure_us": 10.0, "gain_db": 0.1, "bits": 1.0}
LATENCY = 3
"""How often it is asked before it is ready for a trigger."""
FRAMES_BEFORE = 17
"""It has counted others since it was switched on."""


class AcmeBench(ReferenceBench):
    """The reference rig's light, which cameras that are connected look at."""

    present: AcmeBench | None = None

    def open(self) -> None:
        super().open()
        AcmeBench.present = self


class AcmeRoom(AcmeBench):
    """A room with lamps on, to which the projector adds nothing."""

    def light(self, pattern: Pattern | None) -> Floats:
        return super().light(None) + np.linspace(0.05, 0.6, CAMERA_SIZE[0])


@dataclass(frozen=True)
class Received:
    """What comes from the camera: the buffer it keeps, and its number since it was switched on."""

    pixels: NDArray[Any]
    number: int


class Connection:
    """An open camera. It keeps one buffer, quantises what it is told, and never complains."""

    size = CAMERA_SIZE

    def __init__(self, bench: ReferenceBench) -> None:
        self._bench, self._values = bench, {"exposure_us": 1e4, "gain_db": 0.0, "bits": 8.0}
        self._buffer: NDArray[Any] | None = None
        self._source, self._number, self._asked = "software", FRAMES_BEFORE, 0
        self._is_started = self._fired = False

    def range(self, name: str) -> tuple[float, float]:
        return RANGES[name]

    def set(self, name: str, value: float) -> None:
        least, most = RANGES[name]
        self._values[name] = min(max(round(value / STEPS[name]) * STEPS[name], least), most)

    def get(self, name: str) -> float:
        return self._values[name]

    def trigger_by(self, source: str) -> None:
        self._source = source

    def frames_counted(self) -> int:
        return self._number

    def start(self) -> None:
        self._is_started, self._asked = True, 0

    def stop(self) -> None:
        self._is_started = False

    def is_ready(self) -> bool:
        self._asked += 1
        return self._is_started and self._asked > LATENCY

    def flush(self) -> None:
        self._fired = False
        self._bench.pulses.clear()

    def fire(self) -> None:
        self._fired = self._source == "software"

    def wait(self, timeout_s: float) -> Received | None:
        if self._source != "software" and self._asked <= LATENCY and self._bench.pulses:
            self._asked = LATENCY + 1
            self._bench.pulses.popleft()  # came too early
        arrived = False
        while not arrived:
            if not self._is_started or not (self._fired or self._bench.pulses):
                return None
            pattern = self._bench.on_show if self._fired else self._bench.pulses.popleft()
            self._fired = False
            self._number += 1
            arrived = not self._bench.frames_to_lose
            self._bench.frames_to_lose -= not arrived
        return Received(self._expose(pattern), self._number - 1)

    def _expose(self, pattern: Pattern | None) -> NDArray[Any]:
        gain = self._values["exposure_us"] / 1e6 / REFERENCE_EXPOSURE_S * 10 ** (self._values["gain_db"] / 20)
        full = (1 << int(self._values["bits"])) - 1
        seen = np.rint(np.clip(self._bench.light(pattern) * gain, 0.0, 1.0) * full)
        if self._buffer is None:
            self._buffer = np.empty(seen.shape, np.uint16)
        self._buffer[...] = seen
        return self._buffer

    def disconnect(self) -> None:
        self._buffer = None


def connect(serial: str) -> Connection:
    if serial != "A-17":
        raise OSError(f"no camera {serial}")
    if AcmeBench.present is not None:
        return Connection(AcmeBench.present)
    room = ReferenceBench({})
    room.open()
    return Connection(room)
