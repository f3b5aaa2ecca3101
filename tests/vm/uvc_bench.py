"""The light of the reference bench on the sensor of the guest's USB camera."""

import time
from pathlib import Path
from typing import Any

from tests.conformance.reference import ReferenceBench
from tests.vm.uvc import UvcCamera, connected
from tests.vm.uvc_descriptors import NAME

DEVICES = Path("/sys/class/video4linux")
LINK = Path("/run/uvc-camera")
PATIENCE_S = 120.0
"""Time that the kernel is given, on an emulated processor."""


def devices(name: str) -> list[Path]:
    """The device files of a camera: of several, only the first one has frames."""
    found = [path for path in DEVICES.glob("video*") if name in (path / "name").read_text()]
    return [Path("/dev") / path.name for path in found if (path / "index").read_text().strip() == "0"]


def plugged() -> UvcCamera:
    """The camera on USB, with `LINK` to its device file."""
    deadline, camera = time.monotonic() + PATIENCE_S, None
    while camera is None or not devices(NAME):
        assert time.monotonic() < deadline, "the kernel never listed the camera"
        try:
            camera = connected()
            camera.plug()
        except (FileNotFoundError, ConnectionError):
            camera = None  # its process has just been started
        time.sleep(0.05)
    LINK.unlink(missing_ok=True)
    LINK.symlink_to(devices(NAME)[0])
    return camera


class UvcBench(ReferenceBench):
    """Tells the camera's process what is lit."""

    _camera: UvcCamera | None = None

    def __setattr__(self, name: str, value: Any) -> None:
        super().__setattr__(name, value)
        if name == "on_show" and self._camera is not None:
            self._camera.light(self.light(value))

    def open(self) -> None:
        super().open()
        self._camera = plugged()
        self.on_show = None
