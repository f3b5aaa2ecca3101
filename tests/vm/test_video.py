"""Video cameras as the kernel offers them: its own test driver, and a USB camera behind its UVC driver."""

import time
from pathlib import Path

import numpy as np
import pytest

from drivers.video_camera import VideoCamera
from drivers.video_camera.device import VideoDevice
from fpplab.core.errors import CapabilityError, DisconnectedError, StateError
from fpplab.devices import CameraSettings
from tests.vm.uvc import UvcCamera
from tests.vm.uvc_bench import LINK, devices, plugged

VIVID = "vivid"
MIRRORED = 0x0098_0914


@pytest.fixture
def usb() -> UvcCamera:
    return plugged()


def vivid() -> Path:
    """The first device of the kernel's test driver that captures."""
    for path in sorted(devices(VIVID), key=lambda path: int(path.name.removeprefix("video"))):
        device = VideoDevice(str(path))
        captures = device.identity()[2]
        device.close()
        if captures:
            return path
    raise AssertionError("the guest's kernel has no vivid")


@pytest.mark.parametrize(("letters", "width", "height"), [("GREY", 640, 480), ("Y12 ", 320, 180)])
def test_the_kernels_test_driver_delivers_frames(letters: str, width: int, height: int) -> None:
    device = VideoDevice(str(vivid()))
    try:
        assert letters in device.formats()
        device.set_format(letters, width, height)
        assert device.format()[:3] == (letters, width, height)
        pitch = device.format()[3]
        assert device.period_s()
        begin = time.monotonic()
        device.start()
        frames = [device.read(5.0) for _ in range(6)]
        device.stop()
        assert all(frame and frame.pixels.size == height * pitch and not frame.is_damaged for frame in frames)
        times = [frame.time_s for frame in frames if frame and frame.time_s]
        assert begin < times[0]
        assert times == sorted(times)
    finally:
        device.close()


def test_a_control_of_the_kernels_test_driver_does_what_it_says() -> None:
    device = VideoDevice(str(vivid()))
    try:
        device.set_format("GREY", 640, 480)
        seen = []
        for mirrored in (0, 1):
            device.set(MIRRORED, mirrored)
            assert device.get(MIRRORED) == mirrored
            device.start()
            device.read(5.0)
            frame = device.read(5.0)
            device.stop()
            assert frame
            seen.append(np.median(frame.pixels.reshape(480, -1)[300:, :640], axis=0))
        assert np.mean(np.abs(seen[1] - seen[0])) > 20
        near = np.abs(seen[1] - seen[0][::-1]) < 8
        assert near.mean() > 0.98, "all but the edges of its colour bars, which are rounded"
    finally:
        device.close()


def test_the_kernels_test_driver_has_no_exposure_and_is_refused() -> None:
    camera = VideoCamera("camera", {"device": str(vivid())})
    with pytest.raises(CapabilityError, match=r"exposure of vivid cannot be set: it has no such control"):
        camera.open()


def test_a_usb_camera_is_made_raw(usb: UvcCamera) -> None:
    with VideoCamera("camera", {"device": str(LINK), "raw_gain": {"db_per_step": 0.1}}) as camera:
        assert camera.caps.bits == (8, 12)
        assert camera.caps.size == (48, 32)
        assert camera.caps.exposure_s == pytest.approx((1e-4, 0.2))
        back = camera.configure(CameraSettings(0.0123, 6.0, 12))
        assert (back.exposure_s, back.gain_db) == pytest.approx((0.0123, 6.0))
        assert usb.values() == [1, 123, 60, 100]


def test_levels_come_as_the_sensor_counted_them(usb: UvcCamera) -> None:
    ramp = np.linspace(0.0, 1.0, 48 * 32).reshape(32, 48)
    with VideoCamera("camera", {"device": str(LINK)}) as camera:
        for bits in (8, 12):
            usb.light(ramp)
            camera.configure(CameraSettings(0.02, bits=bits))
            image = camera.snap().image
            np.testing.assert_array_equal(image, np.rint(ramp * ((1 << bits) - 1)))


def test_frames_are_of_what_is_lit_when_they_are_asked_for(usb: UvcCamera) -> None:
    with VideoCamera("camera", {"device": str(LINK)}) as camera:
        camera.configure(CameraSettings(0.02))
        camera.arm(10)
        for k in range(10):
            usb.light(np.full((32, 48), float(k % 2)))
            assert camera.read(10.0).image.mean() == 255 * (k % 2)


def test_another_program_has_it(usb: UvcCamera) -> None:
    with VideoCamera("camera", {"device": str(LINK)}) as camera:
        camera.configure(CameraSettings(0.02))
        camera.arm(1)
        with pytest.raises(StateError, match="another program has the camera open"):
            VideoCamera("camera", {"device": str(LINK)}).open()


def test_it_is_unplugged_and_plugged_in(usb: UvcCamera) -> None:
    camera = VideoCamera("camera", {"device": str(LINK)})
    camera.open()
    camera.configure(CameraSettings(0.02))
    camera.arm(3)
    camera.read(10.0)
    usb.unplug()
    with pytest.raises(DisconnectedError, match="there is no camera at"):
        [camera.read(10.0) for _ in range(2)]  # one frame may have come before
    camera.close()
    plugged()
    with VideoCamera("camera", {"device": str(LINK)}) as again:
        again.configure(CameraSettings(0.02))
        assert again.snap().index == 0
