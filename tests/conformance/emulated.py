"""The reference rig with the real camera driver: pylon's emulator sees what the reference projector shows."""

from __future__ import annotations

import threading

import numpy as np

from drivers.emulators.pylon import EmulatedPylon
from fpplab.core.conventions import Image, full_scale, raw_dtype
from fpplab.devices import CameraSettings
from tests.conformance.reference import REFERENCE_EXPOSURE_S, ReferenceBench, ReferenceProjector


class PylonBench(ReferenceBench):
    """The light of the reference bench on the sensor of an emulated camera, `pylon`."""

    def open(self) -> None:
        super().open()
        self.pylon = EmulatedPylon(scene=self._seen)
        self.pylon.start()

    def close(self) -> None:
        self.pylon.close()
        super().close()

    def _seen(self, settings: CameraSettings) -> Image:
        gain = settings.exposure_s / REFERENCE_EXPOSURE_S * 10 ** (settings.gain_db / 20)
        share = np.clip(self.light(self.on_show) * gain, 0.0, 1.0)
        image: Image = np.rint(share * full_scale(settings.bits)).astype(raw_dtype(settings.bits))
        return image


class PulsingProjector(ReferenceProjector):
    """Plays by itself, with a pulse on the camera's line at the beginning of each pattern."""

    _bench: PylonBench
    _player: threading.Thread | None = None

    def _play(self, exposure_s: float, dark_s: float, period_s: float) -> None:
        self._period_s = max(exposure_s + dark_s, period_s)
        self._playing = threading.Event()
        self._playing.set()
        self._player = threading.Thread(target=self._run)
        self._player.start()

    def _run(self) -> None:
        for k, pattern in enumerate(self._held):
            if self._playing.is_set():
                self._bench.on_show = pattern
                self._bench.pylon.pulse(at_s=k * self._period_s)

    def _blank(self) -> None:
        self._end()
        super()._blank()

    def _close(self) -> None:
        self._end()
        super()._close()

    def _end(self) -> None:
        if self._player is not None:
            self._playing.clear()
            self._player.join()
            self._player = None
