"""Single frames of any pattern, for an operator who sets up a rig."""

import time
from collections.abc import Sequence
from dataclasses import replace

from fpplab.acquisition.acquire import READ_TIMEOUT_S, in_step
from fpplab.acquisition.timing import check_stepped
from fpplab.core.errors import SettingError
from fpplab.devices import CameraSettings, Frame, State
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import Pattern


class PatternWatch:
    """Shows one pattern after another on an open rig, dark once that closes, and takes a frame of each."""

    def __init__(
        self, rig: Rig, patterns: Sequence[Pattern], settings: CameraSettings, settle_s: float
    ) -> None:
        self._rig, self._patterns, self._settle_s = rig, patterns, settle_s
        self._shown: int | None = None
        self.settings = rig.camera.configure(settings)
        rig.projector.load(patterns)
        check_stepped(rig.camera)

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Change exposure, gain or depth; if the camera refuses, the previous settings are restored."""
        try:
            self.settings = self._rig.camera.configure(settings)
        except SettingError:
            self._rig.camera.configure(self.settings)
            raise
        return self.settings

    def dark_frame(self) -> Frame:
        camera, projector = self._rig.camera, self._rig.projector
        projector.blank()
        self._shown = None
        shortest_s, longest_s = camera.caps.exposure_s
        # 0.1 ms sees no light of the room; the shortest exposure of some cameras is a mode of its own.
        dark_s = min(max(shortest_s, 1e-4), longest_s)
        try:
            camera.configure(replace(self.settings, exposure_s=dark_s))
            return camera.snap(timeout_s=READ_TIMEOUT_S)
        finally:
            if camera.state is State.IDLE:
                camera.configure(self.settings)

    def frame(self, index: int) -> Frame:
        camera, pattern = self._rig.camera, self._patterns[index]
        if index != self._shown:
            self._shown = None
            self._rig.projector.show(index)
            time.sleep(self._settle_s)  # the display's own latency, which the plan states
            self._shown = index
        return in_step(camera, camera.snap(timeout_s=self.settings.exposure_s + READ_TIMEOUT_S), pattern)
