"""The reference rig with the LightCrafter's driver on the guest's USB: the camera is told what is shown."""

import time
from pathlib import Path
from typing import Any

from fpplab.core.errors import DeviceTimeoutError
from fpplab.devices import Trigger
from fpplab.patterns.fringes import Pattern
from tests.conformance.reference import ReferenceBench, ReferenceCamera
from tests.vm.projector import Projector, connected

POLL_S = 0.005


class UsbBench(ReferenceBench):
    """The driver finds the projector through hidapi. index: file for its flash's."""

    projector: Projector

    def open(self) -> None:
        super().open()
        self.projector = connected()
        Path(self.options["index"]).write_text(self.projector.index(), encoding="utf-8")


class ToldCamera(ReferenceCamera):
    """Exposes on trigger output 1, or immediately."""

    _bench: UsbBench

    def _arm(self, n: int, trigger: Trigger) -> None:
        super()._arm(n, trigger)
        self._bench.projector.forget()

    def _read(self, timeout_s: float) -> Any:
        self._deadline_s = time.monotonic() + timeout_s
        return super()._read(timeout_s)

    def _exposed(self) -> Pattern | None:
        projector = self._bench.projector
        if self._trigger == "software":
            return projector.lit()
        while time.monotonic() < self._deadline_s:
            if caught := projector.caught():
                return caught[0]
            time.sleep(POLL_S)
        raise DeviceTimeoutError(self.name, "read", "no trigger came", "check the trigger cable")
