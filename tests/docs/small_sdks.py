"""What the example drivers are written for, as awkward as the real ones: picamera2, and pylablib."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fpplab.devices import CameraSettings
from tests.conformance.reference import CAMERA_SIZE, sensor_image
from tests.conformance.video_end import VideoBench

FASTEST_US, BITS, BUFFERS, LATE = 4000, 10, 4, 2
ROW_US = FASTEST_US / CAMERA_SIZE[1]
STRIDE_PX = 64  # pixels from row to row in the buffer
DEGREES_PER_S = 4000.0


class PiBench(VideoBench):
    """The light that every camera of this module sees."""

    present: ClassVar[PiBench]

    def open(self) -> None:
        super().open()
        PiBench.present = self


@dataclass
class Request:
    """A finished frame."""

    raw: NDArray[np.uint8]
    metadata: dict[str, Any]

    def make_array(self, name: str) -> NDArray[np.uint8]:
        assert name == "raw"
        return self.raw

    def get_metadata(self) -> dict[str, Any]:
        return self.metadata

    def release(self) -> None: ...


class Picamera2:
    """Exposes all the time, in whole rows; controls act two frames later, and finished frames wait."""

    camera_properties: ClassVar = {"Model": "imx477"}
    camera_controls: ClassVar = {"ExposureTime": (190, 200_000, 20_000), "AnalogueGain": (1.0, 16.0, 1.0)}
    sensor_modes: ClassVar = [
        {"size": (24, 16), "bit_depth": 8, "unpacked": "R8", "fps": 500.0},
        {"size": CAMERA_SIZE, "bit_depth": BITS, "unpacked": "R10", "fps": 1e6 / FASTEST_US},
    ]

    def __init__(self, number: int) -> None:
        self._now = {"ExposureTime": 20_000, "AnalogueGain": 1.0}
        self._next = deque([dict(self._now)] * LATE)
        self._done: deque[Request] = deque()
        self._begin_s: float | None = None

    def create_video_configuration(self, raw: dict[str, Any]) -> dict[str, Any]:
        assert raw == {"format": "R10", "size": CAMERA_SIZE}
        return raw

    def configure(self, configuration: dict[str, Any]) -> None: ...

    def set_controls(self, controls: dict[str, Any]) -> None:
        if "ExposureTime" in controls:
            rows = max(2, round(controls["ExposureTime"] / ROW_US))
            gain = controls["AnalogueGain"]
            self._fill()
            self._asked = {"ExposureTime": round(rows * ROW_US), "AnalogueGain": gain}

    def start(self) -> None:
        self._begin_s = time.monotonic()

    def stop(self) -> None:
        self._begin_s = None

    def close(self) -> None:
        assert self._begin_s is None, "it still runs"

    def capture_metadata(self) -> dict[str, Any]:
        return self.wait(None, 5.0).metadata

    def capture_request(self, wait: bool) -> None:
        assert not wait

    def wait(self, job: None, timeout: float) -> Request:
        deadline_s = time.monotonic() + timeout
        self._fill()
        while not self._done:
            if time.monotonic() > deadline_s:
                raise TimeoutError
            time.sleep(5e-4)
            self._fill()
        return self._done.popleft()

    def _fill(self) -> None:
        """Finish the frames that have been exposed meanwhile; those beyond the buffers are lost."""
        while self._begin_s is not None:
            settings = self._next[0]
            duration_us = max(FASTEST_US, settings["ExposureTime"])
            if self._begin_s + (duration_us + FASTEST_US) * 1e-6 > time.monotonic():
                return
            if len(self._done) < BUFFERS:
                self._done.append(self._exposed(settings, self._begin_s, duration_us))
            self._begin_s += duration_us * 1e-6
            self._next.popleft()
            self._next.append(getattr(self, "_asked", settings))

    def _exposed(self, settings: dict[str, Any], begin_s: float, duration_us: float) -> Request:
        bench = PiBench.present
        gain_db = 20.0 * float(np.log10(settings["AnalogueGain"]))
        exposed = CameraSettings(settings["ExposureTime"] * 1e-6, gain_db, BITS)
        width, height = CAMERA_SIZE
        raw = np.zeros((height, STRIDE_PX), np.uint16)
        raw[:, :width] = sensor_image(bench, bench.lit_at(begin_s), exposed)
        boot_s = time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()
        stamp = round((begin_s + boot_s) * 1e9)
        return Request(
            raw.view(np.uint8), settings | {"SensorTimestamp": stamp, "FrameDuration": round(duration_us)}
        )


class KinesisMotor:
    """A rotation mount that takes time; positions are in degrees, on its own grid."""

    def __init__(self, serial: str, scale: str) -> None:
        assert (serial, scale) == ("55000001", "stage")
        self._from = self._to = 17.3
        self._left_s = time.monotonic()

    def get_device_info(self) -> SimpleNamespace:
        return SimpleNamespace(model_no="K10CR1")

    def home(self, sync: bool, force: bool) -> None:
        assert sync
        assert force
        self._from = self._to = 0.0

    def move_to(self, position: float) -> None:
        self._from, self._to, self._left_s = (
            self.get_position(),
            round(position * 400) / 400,
            time.monotonic(),
        )

    def is_moving(self) -> bool:
        return self.get_position() != self._to

    def get_position(self) -> float:
        turned = DEGREES_PER_S * (time.monotonic() - self._left_s)
        way = self._to - self._from
        return self._to if turned >= abs(way) else self._from + np.sign(way) * turned

    def stop(self, immediate: bool, sync: bool) -> None:
        self._from = self._to = self.get_position()

    def close(self) -> None:
        assert not self.is_moving(), "it still turns"


Thorlabs = SimpleNamespace(KinesisMotor=KinesisMotor)
