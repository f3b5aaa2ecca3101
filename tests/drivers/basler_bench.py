"""Helpers for tests of the Basler driver with emulated cameras."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.basler import BaslerCamera
from fpplab.core.conventions import Image, raw_dtype
from fpplab.core.errors import DisconnectedError
from fpplab.devices import CameraSettings, Frame, State
from tests.support.pulsed_pylon import PulsedCamera, PulsedPylon

SERIAL = "0815-0000"
SIZE = (48, 32)
SETTINGS = CameraSettings(0.02)
SOON_S, LONG_S = 0.05, 20.0


class Counter:
    """A scene whose brightness counts the exposures, so that every frame is different."""

    def __init__(self) -> None:
        self.exposures = 0

    def __call__(self, settings: CameraSettings) -> Image:
        self.exposures += 1
        shade = self.exposures % (1 << settings.bits)
        image: Image = np.full(SIZE[::-1], shade, raw_dtype(settings.bits))
        return image


def driver(bench: PulsedPylon, **options: Any) -> BaslerCamera:
    section = {"serial": SERIAL, "roi": [0, 0, *SIZE], **options}
    return BaslerCamera("camera", section, SimpleNamespace(pylon=bench))


def end(camera: BaslerCamera) -> PulsedCamera:
    """Return the emulated camera of a driver."""
    found: PulsedCamera = camera._camera
    return found


def shade(frame: Frame) -> int:
    assert frame.image.min() == frame.image.max()
    return int(frame.image[0, 0])


def assert_disarmed(camera: BaslerCamera) -> None:
    assert camera.state is State.FAULT
    assert not end(camera).IsGrabbing()


def unplug_once(camera: BaslerCamera, bench: PulsedPylon) -> None:
    """Use a closed camera, pull its cable out while it is open, and plug it in again."""
    camera.open()
    camera.configure(SETTINGS)
    camera.snap()
    bench.unplug()
    with pytest.raises(DisconnectedError):
        camera.snap()
    camera.close()
    bench.plug_in()


def assert_mended(camera: BaslerCamera, bench: PulsedPylon, scene: Counter) -> None:
    """Check that the camera, closed and opened again, takes a current frame."""
    camera.close()
    bench.plug_in()
    camera.open()
    camera.configure(SETTINGS)
    assert shade(camera.snap()) == scene.exposures
