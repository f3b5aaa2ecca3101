"""The emulated controller's video port, and the display of a computer that is connected to it."""

import math
from typing import Protocol

import numpy as np

from drivers.clock import ROUNDING_S, Clock
from drivers.display.window import VideoFrame
from drivers.dlp4500.board import WHOLE_AREA
from drivers.dlp4500.layout import Values
from drivers.dlp4500.sequence import SIZE
from drivers.emulators.dlpc350.light import FlashImage

CHANNEL_ORDERS = ("ABC", "CAB", "BCA", "ACB", "BAC", "CBA")
"""Settings of the channel swap by number: inside the controller, A is green, B red and C blue."""
PORT_CHANNELS = "ABC"  # the port's own channels, on which this board feeds red, green and blue


class Video:
    """The signal at the video port: a frame until the next, a VSYNC every `vsync_s` from time 0."""

    def __init__(self, frame: VideoFrame, vsync_s: float = 1 / 60) -> None:
        self.vsync_s, self.locked = vsync_s, True
        self._frame = self._next = frame.copy()
        self._next_from_s = 0.0

    def set_frame(self, frame: VideoFrame, now_s: float) -> float:
        """Change to another frame at the next VSYNC."""
        # frame (height, width, 3)
        self._frame, self._next = self.frame_at(now_s), frame.copy()
        self._next_from_s = (math.floor((now_s + ROUNDING_S) / self.vsync_s) + 1) * self.vsync_s
        return self._next_from_s

    def frame_at(self, time_s: float) -> VideoFrame:
        # returns (height, width, 3)
        return self._next if time_s + ROUNDING_S >= self._next_from_s else self._frame


def apply_channel_swap(frame: VideoFrame, swap: int, letter_is_input: bool) -> FlashImage:
    """Return the bit planes that a frame fills under a channel swap."""
    # frame (height, width, 3); returns (height, width, 3)
    channels = [PORT_CHANNELS.index(letter) for letter in CHANNEL_ORDERS[swap]]
    return frame[..., channels if letter_is_input else np.argsort(channels)]


def region(area: Values, part: str) -> tuple[slice, slice]:
    """Return the rows and columns of the cropped or of the displayed region."""
    top, left, lines, pixels = (area[f"{part}_{key}"] for key in ("line", "pixel", "lines", "pixels"))
    return slice(top, top + lines), slice(left, left + pixels)


def apply_area(frame: FlashImage, area: Values) -> FlashImage:
    """Return a frame whose cropped region fills the displayed one; the rest is black."""
    # frame (height, width, 3); returns (height, width, 3)
    if area == WHOLE_AREA:
        return frame
    shown, cropped = np.zeros_like(frame), frame[region(area, "crop")]
    height, width, _ = shown[region(area, "display")].shape
    rows, columns = (np.arange(n) * m // n for n, m in zip((height, width), cropped.shape[:2], strict=True))
    shown[region(area, "display")] = cropped[np.ix_(rows, columns)]
    return shown


class VideoReceiver(Protocol):
    """A controller with a video port, as a display that is connected to it needs it."""

    clock: Clock  # of the controller and the display
    video: Video | None  # the signal at the port; the display sets it

    def advance(self) -> None:
        """Do everything that was due until now; called before the display changes the frame."""


class EmulatedDisplay:
    """Stands in for `SdlDisplay` at the controller's video port; while not open, it shows an even grey."""

    def __init__(self, controller: VideoReceiver, vsync_s: float = 1 / 60) -> None:
        self.vsync_s = vsync_s
        width, height = SIZE
        self._desktop = np.full((height, width, 3), 128, np.uint8)  # a grey desktop
        self._controller = controller
        self._video = controller.video = Video(self._desktop, vsync_s)

    def open(self) -> None:
        """Show black."""
        self.show(np.zeros_like(self._desktop))

    def show(self, frame: VideoFrame) -> None:
        """Show a frame and return once it is on the port, at the next VSYNC."""
        # frame (height, width, 3)
        clock = self._controller.clock
        self._controller.advance()  # what was due had the frame before
        clock.sleep(self._video.set_frame(frame, clock.now()) - clock.now())

    def close(self) -> None:
        """Show the desktop again."""
        self.show(self._desktop)
