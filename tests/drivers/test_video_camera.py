"""The driver of video cameras on a scripted device file: fresh frames, raw frames, and what is refused."""

import errno
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.video_camera import VideoCamera
from drivers.video_camera.camera import EXPOSURE_100_US, EXPOSURE_MODE, GAIN
from fpplab.core.errors import (
    CapabilityError,
    DeviceError,
    DisconnectedError,
    FrameLossError,
    SettingError,
    StateError,
)
from fpplab.devices import CameraSettings, State
from fpplab.patterns.fringes import Pattern
from tests.conformance.reference import PROJECTOR_SIZE
from tests.conformance.video_end import FLIP, GAMMA, PERIOD_S, ReferenceVideo, VideoBench

SHORT = CameraSettings(0.002, bits=8)
Open = Callable[..., tuple[VideoCamera, ReferenceVideo, VideoBench]]


@pytest.fixture
def opened() -> Iterator[Open]:
    cameras: list[VideoCamera] = []

    def make(
        prepare: Callable[[ReferenceVideo], None] = lambda end: None, **options: Any
    ) -> tuple[VideoCamera, ReferenceVideo, VideoBench]:
        bench = VideoBench({})
        bench.open()
        end = ReferenceVideo(bench)
        prepare(end)
        shared = SimpleNamespace(video=lambda _: end)
        camera = VideoCamera("camera", {"device": "/dev/video9", **options}, shared)
        cameras.append(camera)
        camera.open()
        return camera, end, bench

    yield make
    for camera in cameras:
        camera.close()


def uniform(level: int) -> Pattern:
    return Pattern(image=np.full(PROJECTOR_SIZE[::-1], level, np.uint8), id=str(level), bit_depth=8)


def shown(camera: VideoCamera, bench: VideoBench, level: int) -> float:
    bench.on_show = uniform(level)
    return float(camera.read(5.0).image.mean())


@pytest.mark.parametrize(("exposure_s", "latency_s"), [(0.002, 0.0), (0.02, 0.0), (0.002, 0.015)])
def test_frames_began_after_they_were_asked_for(opened: Open, exposure_s: float, latency_s: float) -> None:
    def late(end: ReferenceVideo) -> None:
        end.latency_s = latency_s

    camera, _, bench = opened(late, latency_s=latency_s, raw_gain={"db_per_step": 0.1})
    camera.configure(CameraSettings(exposure_s, gain_db=0.0 if exposure_s > 0.01 else 12.0))
    camera.arm(24)
    levels = [shown(camera, bench, 255 * (k % 2)) for k in range(24)]
    assert min(levels[1::2]) > 2 * max(levels[0::2])


def test_all_that_is_not_raw_is_switched_off(opened: Open) -> None:
    camera, end, _ = opened()
    assert (end.values[EXPOSURE_MODE], end.values[GAMMA], end.values[FLIP]) == (1, 100, 0)
    assert camera.caps.bits == (8, 12)
    assert camera.caps.exposure_s == (1e-4, 0.2)
    assert camera.caps.triggers == ("software",)
    assert camera.caps.period_s is None


@pytest.mark.parametrize(
    ("number", "complaint"),
    [
        (EXPOSURE_MODE, "Auto Exposure is 3 and cannot be set to 1"),
        (GAMMA, "Gamma is 220 and cannot be set to 100"),
        (FLIP, "Horizontal Flip is 1 and cannot be set to 0"),
    ],
)
def test_what_stays_is_refused_by_name(opened: Open, number: int, complaint: str) -> None:
    with pytest.raises(SettingError, match=complaint):
        opened(lambda end: end.stuck.add(number))

    def fixed(end: ReferenceVideo) -> None:
        end.controls[number] = replace(end.controls[number], is_settable=False)

    with pytest.raises(SettingError, match=complaint):
        opened(fixed)


def test_a_camera_without_an_exposure_is_refused(opened: Open) -> None:
    def without(end: ReferenceVideo) -> None:
        del end.controls[EXPOSURE_100_US]

    with pytest.raises(CapabilityError, match="exposure of scripted cannot be set: it has no such control"):
        opened(without)


def test_an_exposure_that_stays_automatic_is_refused(opened: Open) -> None:
    def automatic(end: ReferenceVideo) -> None:
        end.controls[EXPOSURE_100_US] = replace(end.controls[EXPOSURE_100_US], is_settable=False)

    with pytest.raises(CapabilityError, match="cannot be set: its automatic exposure stays on"):
        opened(automatic)


def test_converted_frames_are_refused(opened: Open) -> None:
    def colour(end: ReferenceVideo) -> None:
        end.known = {"YUYV": 16, "MJPG": 8}

    with pytest.raises(CapabilityError, match="has only YUYV, MJPG: its frames are converted or compressed"):
        opened(colour)


def test_a_device_that_is_no_camera_is_refused(opened: Open) -> None:
    with pytest.raises(CapabilityError, match="/dev/video9 delivers no frames"):
        opened(lambda end: setattr(end, "captures", False))


@pytest.mark.parametrize(("what", "value"), [("stamps", False), ("ahead_s", 0.1)])
def test_frames_without_a_time_are_refused(opened: Open, what: str, value: Any) -> None:
    camera, _, _ = opened(lambda end: setattr(end, what, value))
    camera.configure(SHORT)
    with pytest.raises(CapabilityError, match="do not state when they were exposed"):
        camera.snap()


def test_the_exposure_is_in_steps_of_100_us(opened: Open) -> None:
    camera, end, _ = opened()
    assert camera.configure(CameraSettings(0.00312)).exposure_s == pytest.approx(0.0031)
    assert end.values[EXPOSURE_100_US] == 31
    with pytest.raises(SettingError, match=r"exposure_s is 0\.3 s"):
        camera.configure(CameraSettings(0.3))


def test_a_gain_is_converted_as_stated(opened: Open) -> None:
    camera, end, _ = opened(raw_gain={"db_per_step": 0.1})
    back = camera.configure(CameraSettings(0.01, gain_db=6.04))
    assert end.values[GAIN] == 60
    assert back.gain_db == pytest.approx(6.0)
    camera, end, _ = opened()
    assert camera.configure(CameraSettings(0.01)).gain_db == 0.0
    assert end.values[GAIN] == 0
    with pytest.raises(SettingError, match="gain_db is 6 dB"):
        camera.configure(CameraSettings(0.01, 6.0))


@pytest.mark.parametrize(("shutter", "readout_s"), [("rolling", PERIOD_S), ("global", 0.0)])
def test_the_shutter_is_as_stated(opened: Open, shutter: str, readout_s: float) -> None:
    assert opened(shutter=shutter)[0].caps.readout_s == readout_s


def test_a_size_that_the_camera_lacks_is_refused(opened: Open) -> None:
    with pytest.raises(SettingError, match="GREY of 640 x 480 px was asked for; the camera has GREY of 48"):
        opened(size=[640, 480])


@pytest.mark.parametrize("bits", [8, 12])
def test_rows_with_a_margin(opened: Open, bits: int) -> None:
    camera, _, bench = opened(lambda end: setattr(end, "margin", 6))
    camera.configure(CameraSettings(0.01, bits=bits))
    bench.on_show = uniform(0)
    image = camera.snap().image
    assert image.shape == (32, 48)
    assert image.max() < 0.1 * (1 << bits), "the margin is white"


def test_a_damaged_frame_is_refused(opened: Open) -> None:
    camera, end, _ = opened()
    camera.configure(SHORT)
    end.damaged = True
    with pytest.raises(FrameLossError, match="frame 0 is damaged: 1536 of 1536 bytes came"):
        camera.snap()
    assert camera.state is State.FAULT
    assert not end.running


def test_an_unplugged_camera(opened: Open) -> None:
    camera, end, _ = opened()
    camera.configure(SHORT)
    camera.arm(2)
    camera.read(1.0)
    end.gone = True
    with pytest.raises(DisconnectedError, match="there is no camera at /dev/video9"):
        camera.read(1.0)


@pytest.mark.parametrize(
    ("number", "kind", "complaint"),
    [
        (errno.ENOENT, DisconnectedError, "there is no camera"),
        (errno.EBUSY, StateError, "another program has the camera open"),
        (errno.EACCES, DeviceError, "usermod -aG video"),
        (errno.EIO, DeviceError, "the kernel says: Input/output error"),
    ],
)
def test_a_device_file_that_does_not_open(number: int, kind: type[DeviceError], complaint: str) -> None:
    import os

    def fail(path: str) -> None:
        raise OSError(number, os.strerror(number))

    with pytest.raises(kind, match=complaint):
        VideoCamera("camera", {"device": "/dev/video9"}, SimpleNamespace(video=fail)).open()


def test_the_kernels_own_file_is_asked(tmp_path: Any) -> None:
    with pytest.raises(DisconnectedError):
        VideoCamera("camera", {"device": str(tmp_path / "video0")}).open()
    (tmp_path / "video0").write_bytes(b"")
    with pytest.raises(DeviceError, match="the kernel says: Inappropriate ioctl for device"):
        VideoCamera("camera", {"device": str(tmp_path / "video0")}).open()
