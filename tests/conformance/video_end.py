"""A video camera that runs freely, in place of the kernel: late, buffered, and found with all automatic.

Frames that nobody takes fill four buffers, and stay there while newer ones are lost, as in the kernel. A
frame shows what was lit when it began, so that a driver that takes a stale one sees the pattern from before.
It is stamped at the end of its readout, and later by what the camera holds it back.
"""

from __future__ import annotations

import errno
import time
from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np

from drivers.video_camera.camera import EXPOSURE_100_US, EXPOSURE_MODE, GAIN
from drivers.video_camera.device import BUFFERS, Control, StampedFrame
from fpplab.core.conventions import Image
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern
from tests.conformance.reference import CAMERA_SIZE, ReferenceBench, sensor_image

PERIOD_S = 0.002
GAMMA, FLIP = 0x0098_0910, 0x0098_0914
FORMATS = {"YUYV": 16, "GREY": 8, "Y12 ": 12}


def control(name: str, least: int, most: int, default: int = 0, step: int = 1) -> Control:
    return Control(name, least, most, step, default, True)


class ScriptedVideo:
    """An open device, in place of `drivers.video_camera.device.VideoDevice`; a subclass has its frames."""

    frame_s = PERIOD_S

    def __init__(self, size: tuple[int, int]) -> None:
        self._size = size
        self.controls = {
            EXPOSURE_MODE: control("Auto Exposure", 0, 3, 3),
            EXPOSURE_100_US: control("Exposure Time, Absolute", 1, 2000, 157),
            GAIN: control("Gain", 0, 120),
            GAMMA: control("Gamma", 72, 500, 120),
            FLIP: control("Horizontal Flip", 0, 1),
        }
        self.values = {EXPOSURE_MODE: 3, EXPOSURE_100_US: 157, GAIN: 40, GAMMA: 220, FLIP: 1}
        self.stuck: set[int] = set()
        self.known = dict(FORMATS)
        self.now: tuple[str, int, int, int] = ("YUYV", *size, 2 * size[0])
        self.margin, self.captures, self.stamps, self.damaged, self.gone = 0, True, True, False, False
        self.running = False

    @property
    def settings(self) -> CameraSettings:
        return CameraSettings(
            self.values[EXPOSURE_100_US] * 1e-4, 0.1 * self.values[GAIN], self.known[self.now[0]]
        )

    def close(self) -> None:
        self.running = False

    def identity(self) -> tuple[str, str, bool]:
        return "scripted", "bus 1", self.captures

    def formats(self) -> tuple[str, ...]:
        return tuple(self.known)

    def format(self) -> tuple[str, int, int, int]:
        return self.now

    def set_format(self, letters: str, width: int, height: int) -> None:
        self._check()
        assert not self.running, "the kernel refuses this while frames come"
        pitch = self._size[0] * (1 if self.known[letters] == 8 else 2) + self.margin
        self.now = (letters, *self._size, pitch)

    def period_s(self) -> float:
        return self.frame_s

    def control(self, number: int) -> Control | None:
        found = self.controls.get(number)
        automatic = number == EXPOSURE_100_US and self.values.get(EXPOSURE_MODE, 1) != 1
        return replace(found, is_settable=found.is_settable and not automatic) if found else None

    def get(self, number: int) -> int:
        self._check()
        return self.values[number]

    def set(self, number: int, value: int) -> None:
        self._check()
        if number in self.stuck:
            raise OSError(errno.EINVAL, "Invalid argument")
        found = self.controls[number]
        assert found.minimum <= value <= found.maximum, "the kernel would clamp it"
        self.values[number] = value

    def start(self) -> None:
        self._check()
        assert not self.running
        self.running = True

    def stop(self) -> None:
        self.running = False

    def _check(self) -> None:
        if self.gone:
            raise OSError(errno.ENODEV, "No such device")

    def _stamped(self, image: Image, stamp_s: float) -> StampedFrame:
        _, width, height, pitch = self.now
        rows = np.full((height, pitch), 255, np.uint8)
        rows[:, : width * image.itemsize] = image.view(np.uint8).reshape(height, -1)
        return StampedFrame(rows.reshape(-1), stamp_s if self.stamps else None, self.damaged)


class ReferenceVideo(ScriptedVideo):
    """Sees the light of the reference bench."""

    def __init__(self, bench: VideoBench) -> None:
        super().__init__(CAMERA_SIZE)
        self._bench, self.latency_s, self.ahead_s = bench, 0.0, 0.0

    def start(self) -> None:
        super().start()
        self._waiting, self._end_s = deque[float](), time.monotonic()

    def _fill(self) -> None:
        step, later_s = max(PERIOD_S, self.settings.exposure_s), PERIOD_S + self.latency_s
        while self._end_s + step + later_s <= time.monotonic():
            self._end_s += step
            if len(self._waiting) < BUFFERS:
                self._waiting.append(self._end_s)

    def read(self, timeout_s: float) -> StampedFrame | None:
        self._check()
        assert self.running
        deadline = time.monotonic() + timeout_s
        self._fill()
        while not self._waiting:
            if time.monotonic() >= deadline:
                return None
            time.sleep(5e-4)
            self._fill()
        end_s = self._waiting.popleft()
        lit = self._bench.lit_at(end_s - self.settings.exposure_s)
        image = sensor_image(self._bench, lit, self.settings)
        return self._stamped(image, end_s + PERIOD_S + self.latency_s + self.ahead_s)


class VideoBench(ReferenceBench):
    """The light of the reference bench on the sensor of a scripted camera, and since when it is lit."""

    def __init__(self, options: dict[str, Any]) -> None:
        self._lit: list[tuple[float, Pattern | None]] = [(0.0, None)]
        super().__init__(options)

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "on_show":
            self._lit.append((time.monotonic(), value))
        super().__setattr__(name, value)

    def lit_at(self, time_s: float) -> Pattern | None:
        return next(pattern for since_s, pattern in reversed(self._lit) if since_s <= time_s)

    def video(self, path: str) -> ReferenceVideo:
        return ReferenceVideo(self)
