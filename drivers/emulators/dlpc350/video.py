"""The emulated controller's video port, and the display of a computer that is connected to it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from drivers.dlp4500.display import VideoFrame
from drivers.dlp4500.sequence import SIZE
from drivers.emulators.dlpc350.light import FlashImage

if TYPE_CHECKING:
    from drivers.emulators.dlpc350.firmware import Dlpc350

SWAPS = ("ABC", "CAB", "BCA", "ACB", "BAC", "CBA")
"""Settings of the channel swap: inside, A is green, B red and C blue."""
PORT = "ABC"
"""The port's own channels, on which this board brings red, green and blue."""
EARLY_S = 1e-9
"""A VSYNC that comes this much too early by rounding alone still is that one."""
DESKTOP_GREY = 128


class Video:
    """What comes in at the port: a frame until another begins, with a VSYNC every `vsync_s` from time 0 on.

    locked: whether the controller follows it.
    """

    def __init__(self, frame: VideoFrame, vsync_s: float = 1 / 60) -> None:
        self.vsync_s, self.locked = vsync_s, True
        self._frame = self._next = frame.copy()
        self._next_from_s = 0.0

    def put(self, frame: VideoFrame, now_s: float) -> float:
        """Have another frame from the next VSYNC on; returns when that is."""
        self._frame, self._next = self.at(now_s), frame.copy()
        self._next_from_s = (math.floor((now_s + EARLY_S) / self.vsync_s) + 1) * self.vsync_s
        return self._next_from_s

    def at(self, time_s: float) -> VideoFrame:
        """The frame at a time since the last but one was put up."""
        return self._next if time_s + EARLY_S >= self._next_from_s else self._frame


def planes_of(frame: VideoFrame, swap: int, names_the_input: bool) -> FlashImage:
    """The planes that a frame fills under a channel swap; for `names_the_input` see `Policy`."""
    channels = [PORT.index(letter) for letter in SWAPS[swap]]
    return frame[..., channels if names_the_input else np.argsort(channels)]


class EmulatedDisplay:
    """Stands in for `drivers.dlp4500.display.SdlDisplay`: what it shows is on the controller's video port.

    Whenever it is not open the desktop is there.
    """

    def __init__(self, controller: Dlpc350, vsync_s: float = 1 / 60) -> None:
        self.vsync_s = vsync_s
        width, height = SIZE
        self._desktop = np.full((height, width, 3), DESKTOP_GREY, np.uint8)
        self._controller = controller
        self._video = controller.video = Video(self._desktop, vsync_s)

    def open(self) -> None:
        """Show black."""
        self.show(np.zeros_like(self._desktop))

    def show(self, frame: VideoFrame) -> None:
        """Put up a frame; returns once it is on the wire."""
        clock = self._controller.clock
        self._controller.advance()  # what was due had the frame before
        clock.sleep(self._video.put(frame, clock.now()) - clock.now())

    def close(self) -> None:
        """Show the desktop again."""
        self.show(self._desktop)
