"""The reference rig with the real camera driver: pylon's emulator sees what the reference projector shows."""

import threading

from fpplab.core.conventions import Image
from fpplab.devices import CameraSettings
from tests.conformance.reference import ReferenceBench, ReferenceProjector, sensor_image
from tests.support.pulsed_pylon import PulsedPylon


class PylonBench(ReferenceBench):
    """The light of the reference bench on the sensor of an emulated camera, `pylon`."""

    def open(self) -> None:
        super().open()
        self.pylon = PulsedPylon(scene=self._seen)
        self.pylon.start()

    def close(self) -> None:
        self.pylon.close()
        super().close()

    def lose_frames(self, n: int) -> None:
        for camera in self.pylon._open.values():
            camera.frames_to_lose = n

    def _seen(self, settings: CameraSettings) -> Image:
        return sensor_image(self, self.on_show, settings)


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
                self._bench.pylon.pulse(rise_s=k * self._period_s)

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
