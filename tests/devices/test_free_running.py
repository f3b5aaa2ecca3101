"""Which frames of a camera that runs freely are fit: fresh, with the settings of now, after a warm-up."""

import time
from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from fpplab.core.errors import CapabilityError, DeviceTimeoutError, SettingError
from fpplab.devices import CameraCaps, CameraSettings, DeviceInfo, FreeFrame, FreeRun, FreeRunningCamera

PERIOD_S = 0.001
SETTINGS = CameraSettings(0.002)


class Scripted(FreeRunningCamera):
    """Its frames are given, and carry their number as grey level."""

    run = FreeRun(PERIOD_S, queued=2)
    shift = 1.0

    def _open(self) -> None:
        self.waiting, self.served = deque[FreeFrame](), 0

    def _close(self) -> None: ...

    def _info(self) -> DeviceInfo:
        return DeviceInfo("camera", "scripted", "1", "memory")

    def _caps(self) -> CameraCaps:
        return CameraCaps((2, 2), (8,), (1e-4, 1.0), (0.0, 0.0), ("software",), exposure_step_s=1e-3)

    def _configure(self, settings: CameraSettings) -> CameraSettings:
        return replace(settings, exposure_s=self.shift * settings.exposure_s)

    def _run(self) -> FreeRun:
        return self.run

    def _start(self) -> None: ...

    def _stop(self) -> None: ...

    def _next(self, timeout_s: float) -> FreeFrame | None:
        if not self.waiting:
            return None
        self.served += 1
        return replace(self.waiting.popleft(), image=np.full((2, 2), self.served, np.uint8))


@pytest.fixture
def camera() -> Scripted:
    camera = Scripted("camera", {})
    camera.open()
    camera.configure(SETTINGS)
    return camera


def level(camera: Scripted) -> int:
    return int(camera.read(0.1).image[0, 0])


def frames(*seconds_from_now: float | None, exposure_s: float | None = None) -> list[FreeFrame]:
    now = time.monotonic()
    return [FreeFrame(np.empty(0), None if s is None else now + s, exposure_s) for s in seconds_from_now]


def test_frames_without_a_time_are_dropped_by_number(camera: Scripted) -> None:
    camera.waiting.extend(frames(*[None] * 8))
    camera.arm(2)
    assert [level(camera), level(camera)] == [4, 8]


def test_a_frame_with_a_time_counts_once_it_began_after_the_call(camera: Scripted) -> None:
    camera.arm(1)
    camera.waiting.extend(frames(-1.0, 0.0))
    with pytest.raises(DeviceTimeoutError, match="no frame that began after it was asked for"):
        camera.read(0.1)


def test_warm_up_and_late_settings_are_dropped_once(camera: Scripted) -> None:
    camera.run = FreeRun(PERIOD_S, queued=0, late=2, warm_up=1)
    camera.waiting.extend(frames(*[None] * 20))
    camera.arm(2)
    assert [level(camera), level(camera)] == [5, 7]
    camera.arm(1)  # nothing was set: only the warm-up is dropped
    assert level(camera) == 10
    camera.configure(SETTINGS)
    camera.arm(1)
    assert level(camera) == 15


def test_a_frame_with_another_exposure_is_dropped(camera: Scripted) -> None:
    camera.run = FreeRun(PERIOD_S, queued=0)
    camera.waiting.extend(frames(None, None, exposure_s=0.02) + frames(None, exposure_s=0.002))
    camera.arm(1)
    assert level(camera) == 3


def test_a_time_ahead_of_the_clock_is_refused(camera: Scripted) -> None:
    camera.arm(1)
    camera.waiting.extend(frames(5.0))
    with pytest.raises(CapabilityError, match="do not state when they were exposed"):
        camera.read(0.1)


def test_an_exposure_between_two_rows_is_the_nearest_rows(camera: Scripted) -> None:
    camera.shift = 1.2  # 0.4 ms off, with steps of 1 ms
    assert camera.configure(SETTINGS).exposure_s == pytest.approx(0.0024)
    camera.shift = 1.3
    with pytest.raises(SettingError, match="was asked for, but the device reads"):
        camera.configure(SETTINGS)


@pytest.mark.parametrize(("shift", "unit"), [(1e3, "ms"), (1e6, "µs")])
def test_an_exposure_in_another_unit_is_told(camera: Scripted, shift: float, unit: str) -> None:
    camera.shift = shift
    with pytest.raises(SettingError, match=f"`_configure` gives the exposure in {unit}; it is in s"):
        camera.configure(SETTINGS)
