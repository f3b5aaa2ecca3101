"""A virtual X server whose screen can be read, and a camera that sees it through another rig's optics."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.display.device import srgb_light
from drivers.emulators.bench import EmulatedFixture
from drivers.emulators.optics import OpticsRig
from drivers.video_camera.device import StampedFrame
from fpplab.core.conventions import Floats
from fpplab.devices import Camera, CameraCaps, CameraSettings, DeviceInfo, Fixture, Frame, Trigger
from fpplab.devices.rig import Rig
from tests.conformance.video_end import ScriptedVideo

LOOK_S = 0.002
"""How often the camera looks at the screen while it is exposed."""
SPOILED: dict[str, Callable[[NDArray[np.uint8]], NDArray[np.uint8]]] = {
    "scaled": lambda p: p[np.ix_(*(np.arange(n) * 15 // 16 for n in p.shape[:2]))],
    "offset": lambda p: np.roll(p, 8, axis=1),
    "colour-managed": lambda p: np.rint(255.0 * (p / 255.0) ** (1 / 2.2)).astype(np.uint8),
}
"""What goes wrong on the way from the computer to the projector."""


class XServer:
    """Xvfb with one screen, whose pixels are in a file."""

    def __init__(self, number: str, file: Path) -> None:
        self.number, self._file = number, file

    @property
    def environment(self) -> dict[str, str]:
        return {"SDL_VIDEODRIVER": "x11", "DISPLAY": f":{self.number}"}

    def use(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for name, value in self.environment.items():
            monkeypatch.setenv(name, value)

    def screen(self) -> NDArray[np.uint8]:
        """What is on the screen, (height, width, 3), from the server's own dump in XWD format."""
        data = self._file.read_bytes()  # 25 numbers, a name, colours, pixels
        fields = struct.unpack(">25I", data[:100])
        size, width, height, stride, colours = fields[0], fields[4], fields[5], fields[12], fields[19]
        pixels = np.frombuffer(data, np.uint8, stride * height, size + 12 * colours).reshape(height, stride)
        return pixels[:, : 4 * width].reshape(height, width, 4)[..., 2::-1]


@contextmanager
def x_server(size: tuple[int, int]) -> Iterator[XServer]:
    """Xvfb while it is needed; the test is skipped where it is not installed."""
    program = shutil.which("Xvfb")
    if program is None:
        pytest.skip("no Xvfb on this computer")
    with TemporaryDirectory(prefix="xvfb-") as folder:
        read, write = os.pipe()
        server = subprocess.Popen(
            [program, "-displayfd", str(write), "-screen", "0", "{}x{}x24".format(*size), "-fbdir", folder],
            pass_fds=[write],
            stderr=subprocess.DEVNULL,
        )
        try:
            os.close(write)
            with os.fdopen(read) as told:
                number = told.readline().strip()
            yield XServer(number, Path(folder) / "Xvfb_screen0")
        finally:
            server.terminate()
            server.wait()


class XScreenBench:
    """An X server for the projector's display, and `optics`, the rig that photographs its screen.

    `curve` is the display's: light from pixel values. `spoiled` names what is done to the pixels on the way.
    """

    def __init__(self, options: dict[str, Any]) -> None:
        self._size = tuple(options.pop("size"))
        self._optics = options.pop("optics")
        self.curve = options.pop("curve", "linear")
        self.spoil = SPOILED.get(options.pop("spoiled", ""), lambda pixels: pixels)

    def open(self) -> None:
        with ExitStack() as stack:
            self.server = stack.enter_context(x_server(self._size))
            patch = stack.enter_context(pytest.MonkeyPatch.context())
            self.server.use(patch)
            self.optics_rig = stack.enter_context(Rig.load(self._optics))
            self.optics = OpticsRig(self.optics_rig)
            self._stack = stack.pop_all()

    def close(self) -> None:
        self._stack.close()

    def light(self) -> Floats:
        """Of the screen, 255 for white; (height, width)."""
        values = self.spoil(self.server.screen()).mean(axis=2)
        return 255.0 * srgb_light(values / 255.0) if self.curve == "srgb" else values

    def collected(self, exposure_s: float) -> NDArray[np.uint8]:
        """Mean light of the exposure: each look counts until the next."""
        begin = last = time.perf_counter()
        light, total = self.light(), 0.0
        collected = np.zeros_like(light)
        while last < begin + exposure_s:
            time.sleep(min(LOOK_S, begin + exposure_s - last))
            now = min(time.perf_counter(), begin + exposure_s)
            collected, total, last = collected + light * (now - last), total + now - last, max(now, last)
            if now >= begin + exposure_s:
                break
            light = self.light()
        return np.rint(collected / total).astype(np.uint8)


class ScreenAndVideoBench(XScreenBench):
    """Also has a video camera that sees the screen, in place of the kernel's."""

    def video(self, path: str) -> ScreenVideo:
        """The device of a camera that the kernel offers."""
        return ScreenVideo(self)


class XScreenCamera(Camera):
    """Sees what the optics see of the screen's light, integrated over the exposure in real time."""

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        super()._setup(options, bench)
        self._bench: XScreenBench = bench

    def _open(self) -> None:
        self._index = 0

    def _close(self) -> None:
        """Nothing to make safe."""

    def _info(self) -> DeviceInfo:
        return DeviceInfo("camera", "X screen", "x1", "memory")

    def _caps(self) -> CameraCaps:
        return CameraCaps(self._bench.optics.size, (8,), (1e-4, 1.0), (0.0, 0.0), ("software",))

    def _configure(self, settings: CameraSettings) -> CameraSettings:
        return settings

    def _arm(self, n: int, trigger: Trigger) -> None:
        self._index = 0

    def _read(self, timeout_s: float) -> Frame:
        settings, bench = self._configured("read"), self._bench
        image = bench.optics.capture(settings, bench.collected(settings.exposure_s), lambda: ())
        index, self._index = self._index, self._index + 1
        return Frame(image, index, settings, time.time())

    def _stop(self) -> None:
        """Nothing is under way between calls."""


class ScreenVideo(ScriptedVideo):
    """A video camera that sees the screen, in place of the kernel: it exposes when it is asked for a frame.

    The first frame after a start was exposed before, as of any camera that runs freely.
    """

    frame_s = 0.016

    def __init__(self, bench: XScreenBench) -> None:
        self._screen = bench
        super().__init__(bench.optics.size)

    def start(self) -> None:
        super().start()
        self._stale: tuple[NDArray[np.uint8], float] | None = (
            np.rint(self._screen.light()).astype(np.uint8),
            time.monotonic(),
        )

    def read(self, timeout_s: float) -> StampedFrame | None:
        assert self.running
        if self._stale is None:
            light = self._screen.collected(self.settings.exposure_s)
            time.sleep(self.frame_s)
            stamp_s = time.monotonic()
        else:
            (light, stamp_s), self._stale = self._stale, None
        return self._stamped(self._screen.optics.capture(self.settings, light, lambda: ()), stamp_s)


class XScreenFixture(EmulatedFixture):
    """The fixture of the optics."""

    def _setup(self, options: dict[str, Any], shared: Any) -> None:
        Fixture._setup(self, options, shared)
        self._bench = shared
