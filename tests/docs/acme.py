"""The SDK of an imaginary maker of cameras, as small and as awkward as real ones: the camera of the how-to.

Its sensor looks at the reference rig of the conformance suite.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.conformance.reference import CAMERA_SIZE, REFERENCE_EXPOSURE_S, ReferenceBench

RANGES = {"exposure_us": (100.0, 1e6), "gain_db": (0.0, 12.0), "bits": (8.0, 12.0)}
STEPS = {"exposure_us": 10.0, "gain_db": 0.1, "bits": 1.0}


class AcmeBench(ReferenceBench):
    """The reference rig's light, which cameras that are connected look at."""

    present: AcmeBench | None = None

    def open(self) -> None:
        super().open()
        AcmeBench.present = self


class Connection:
    """An open camera. It keeps one buffer, quantises what it is told, and never complains."""

    size = CAMERA_SIZE

    def __init__(self, bench: ReferenceBench) -> None:
        self._bench, self._values = bench, {"exposure_us": 1e4, "gain_db": 0.0, "bits": 8.0}
        self._buffer: NDArray[Any] | None = None
        self._fired = False

    def range(self, name: str) -> tuple[float, float]:
        return RANGES[name]

    def set(self, name: str, value: float) -> None:
        least, most = RANGES[name]
        self._values[name] = min(max(round(value / STEPS[name]) * STEPS[name], least), most)

    def get(self, name: str) -> float:
        return self._values[name]

    def flush(self) -> None:
        self._fired = False

    def fire(self) -> None:
        self._fired = True

    def wait(self, timeout_s: float) -> NDArray[Any] | None:
        if not self._fired:
            return None
        self._fired = False
        gain = self._values["exposure_us"] / 1e6 / REFERENCE_EXPOSURE_S * 10 ** (self._values["gain_db"] / 20)
        full = (1 << int(self._values["bits"])) - 1
        seen = np.rint(np.clip(self._bench.light(self._bench.on_show) * gain, 0.0, 1.0) * full)
        if self._buffer is None:
            self._buffer = np.empty(seen.shape, np.uint16)
        self._buffer[...] = seen
        return self._buffer

    def disconnect(self) -> None:
        self._buffer = None


def connect(serial: str) -> Connection:
    if serial != "A-17" or AcmeBench.present is None:
        raise OSError(f"no camera {serial}")
    return Connection(AcmeBench.present)
