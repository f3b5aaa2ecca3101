"""The three devices before one scene, the video camera of them on the guest's USB."""

from fpplab.core.conventions import Floats
from tests.drivers.three_devices import ThreeDevicesBench
from tests.vm.uvc_bench import plugged


class ScreenBench(ThreeDevicesBench):
    """Lights the sensor of the camera behind the kernel's UVC driver."""

    def open(self) -> None:
        self._usb = plugged()
        super().open()

    def light_sensor(self, share: Floats) -> None:
        self._usb.light(share)
