"""A display projector, the guest's USB camera and a stage before one scene, by their own drivers.

What the projector shows is read from the screen of an X server, another rig makes a picture of it, and that
lights the sensor of the camera behind the kernel's UVC driver.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from drivers.display.window import SdlDisplay, VideoFrame
from drivers.emulators.grbl import GrblController
from drivers.emulators.grbl.drive import Rail
from drivers.emulators.grbl.settings import DEFAULTS
from drivers.emulators.terminal import PseudoTerminal
from fpplab.devices import CameraSettings
from tests.conformance.grbl import TIMES_FASTER
from tests.drivers.x_screen import XScreenBench
from tests.vm.uvc import REFERENCE_EXPOSURE_S
from tests.vm.uvc_bench import PATIENCE_S, plugged

PULL_OFF_MM = DEFAULTS[27]
STEP_DIGITS = 4
POLL_S = 0.01


class SeenDisplay(SdlDisplay):
    """Has the bench look at each frame once it is on the screen."""

    def __init__(self, bench: ScreenBench, size: tuple[int, int]) -> None:
        super().__init__("projector", 0, size)
        self._bench = bench

    def show(self, frame: VideoFrame, refreshes: int | None = None) -> None:
        super().show(frame, refreshes)
        if refreshes is None:
            self._bench.look(frame)


class ScreenBench(XScreenBench):
    """The three devices around the scene of `optics`."""

    def __init__(self, options: dict[str, Any]) -> None:
        self._seen_px = tuple(options["size"])
        super().__init__(options)

    def open(self) -> None:
        super().open()
        try:
            self._open_devices()
        except BaseException:
            self.close()
            raise

    def _open_devices(self) -> None:
        self._usb = plugged()
        self.display = SeenDisplay(self, self._seen_px)
        optical = self.optics_rig.stage
        travel_mm = (optical.caps.travel_mm[1] if optical else 50.0) + PULL_OFF_MM
        rail = Rail(length_mm=travel_mm + 5.0, start_mm=PULL_OFF_MM)
        self._grbl = GrblController(lambda: TIMES_FASTER * time.monotonic(), {130: travel_mm}, rail)
        self._terminal = self._stack.enter_context(PseudoTerminal(self._grbl))
        self.stage_port = self._terminal.port

    def look(self, frame: VideoFrame) -> None:
        """Light the camera's sensor with what is on the screen, where the stage stands.

        The server draws a little after it was told to, on an emulated processor much later.
        """
        deadline_s = time.monotonic() + PATIENCE_S
        while not np.array_equal(self.server.screen(), frame):
            assert time.monotonic() < deadline_s, "the server never drew the frame"
            time.sleep(POLL_S)
        with self._terminal.lock:
            carriage_mm = self._grbl.drive.carriage_mm
        self.optics.move_stage(round(carriage_mm - PULL_OFF_MM, STEP_DIGITS))
        settings = CameraSettings(REFERENCE_EXPOSURE_S, bits=12)
        light = np.rint(self.light()).astype(np.uint8)
        image = self.optics.capture(settings, light, lambda: ())
        self._usb.light(image / 4095.0)
