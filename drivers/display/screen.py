"""The process that drives a display through SDL: frames come in shared memory, commands over a pipe.

It ends when the other end of the pipe is closed, for whatever reason.
"""

from __future__ import annotations

import os
import signal
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from ctypes import byref, c_int, create_string_buffer
from dataclasses import dataclass
from itertools import pairwise
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from statistics import median
from typing import Any

from drivers.apart import native_stderr_silenced

QUEUED_FRAMES = 3
"""Frames that drivers and compositors may queue: a frame is transmitted once this number of further ones
was presented.

Chosen: triple buffering queues two.
"""
WHOLE_RATES_HZ = (24, 30, 60, 120)
"""Refresh rates whose television variants, 59.94 Hz for 60 Hz, are reported as the whole number below."""
MIN_SHARE_OF_PERIOD = 0.7
"""Share of the refresh period below which frames are not synchronised to the display (chosen)."""
HINTS = {
    b"SDL_NO_SIGNAL_HANDLERS": b"1",
    b"SDL_VIDEO_MINIMIZE_ON_FOCUS_LOSS": b"0",  # the operator works on another display
    b"SDL_WINDOWS_DPI_AWARENESS": b"permonitorv2",  # no scaling by the desktop
    b"SDL_RENDER_SCALE_QUALITY": b"nearest",
}
"""SDL's hints, set before it starts."""
INVISIBLE_DRIVERS = (b"offscreen", b"dummy")
"""Video drivers that SDL falls back to where there is no display; what they show is not visible."""
REMEDY = "check the display's cable and settings"


@dataclass(frozen=True)
class DisplayInfo:
    """A display of this computer, as SDL reports it."""

    index: int  # its number, from 0
    name: str  # its name, such as that of its connector or model
    size: tuple[int, int]  # width and height in px, as it is set
    refresh_hz: int  # refresh rate in Hz, television rates as the whole number below; 0 if not reported
    is_main: bool  # whether its upper left corner is the desktop's origin

    def __str__(self) -> str:
        return "{} '{}' ({} x {})".format(self.index, self.name, *self.size)


@dataclass(frozen=True)
class OpenedScreen:
    """What is known of a display once it is open, to be sent to the driver's process."""

    display: DisplayInfo  # the display
    vsync_s: float  # its refresh period in s


@dataclass(frozen=True)
class ShowFrame:
    """Command to show the frame in shared memory."""

    refreshes: int | None = None  # for how many refreshes, with black before and after


@dataclass(frozen=True)
class ScreenFailure:
    """Description of a failure, to be sent to the driver's process."""

    reason: str  # what is wrong
    remedy: str  # what the operator can do


class ScreenError(Exception):
    """The display is not, or no longer, usable as required."""

    def __init__(self, reason: str, remedy: str = REMEDY) -> None:
        super().__init__(reason)
        self.failure = ScreenFailure(reason, remedy)


def serve_screen(connection: Connection, display_id: int | str, size: tuple[int, int] | None) -> None:
    """Drive the display until the connection is closed."""
    # After opening an `OpenedScreen` is sent. The name of the shared memory for frames (red, green, blue of
    # each pixel, row by row) is expected first, and then `ShowFrame` commands; after each the refresh period
    # in s is sent. A `ScreenFailure` is sent instead if the display fails.
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the driver's process handles Ctrl-C
    with suppress(EOFError, OSError), native_stderr_silenced():
        try:
            with open_screen(display_id, size) as screen:
                connection.send(OpenedScreen(screen.display, screen.vsync_s))
                memory = SharedMemory(connection.recv())
                assert memory.buf is not None
                while True:
                    while not connection.poll(0.02):
                        screen.process_events()
                    command = connection.recv()
                    screen.show(bytes(memory.buf[: screen.frame_bytes]), command.refreshes)
                    connection.send(screen.vsync_s)
        except ScreenError as error:
            connection.send(error.failure)


def serve_displays(connection: Connection) -> None:
    """Send the list of displays, or a `ScreenFailure`."""
    try:
        with native_stderr_silenced(), _sdl_video() as sdl:
            connection.send(_displays(sdl))
    except ScreenError as error:
        connection.send(error.failure)


def _displays(sdl: Any) -> list[DisplayInfo]:
    displays = []
    for index in range(sdl.SDL_GetNumVideoDisplays()):
        mode, bounds = sdl.SDL_DisplayMode(), sdl.SDL_Rect()
        sdl.SDL_GetCurrentDisplayMode(index, byref(mode))
        sdl.SDL_GetDisplayBounds(index, byref(bounds))
        name = (sdl.SDL_GetDisplayName(index) or b"").decode()
        is_main = (bounds.x, bounds.y) == (0, 0)
        displays.append(DisplayInfo(index, name, (mode.w, mode.h), mode.refresh_rate, is_main))
    return displays


@contextmanager
def _sdl_video() -> Iterator[Any]:
    """SDL with its video part, or `ScreenError`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PySDL2 warns about which SDL library it uses
        import sdl2
    for hint, value in HINTS.items():
        sdl2.SDL_SetHint(hint, value)
    if sdl2.SDL_Init(sdl2.SDL_INIT_VIDEO):
        raise ScreenError(
            f"SDL finds no displays ({sdl2.SDL_GetError().decode()})", "start a graphical session"
        )
    try:
        if sdl2.SDL_GetCurrentVideoDriver() in INVISIBLE_DRIVERS and "SDL_VIDEODRIVER" not in os.environ:
            raise ScreenError("there is no graphical session", "start one, and run this in it")
        yield sdl2
    finally:
        sdl2.SDL_Quit()


@contextmanager
def open_screen(display_id: int | str, size: tuple[int, int] | None = None) -> Iterator[Screen]:
    """Open a display and show black; the display is released at the end of the context."""
    with _sdl_video() as sdl:
        yield Screen(sdl, display_id, size)


class Screen:
    """A window that covers a whole display."""

    def __init__(self, sdl: Any, display_id: int | str, size: tuple[int, int] | None) -> None:
        self._sdl = sdl
        self.display = _choose_display(_displays(sdl), display_id, size)
        self._size = self.display.size
        self.frame_bytes = 3 * self._size[0] * self._size[1]
        self._renderer, self._window = self._create_window(self.display.index)
        sdl.SDL_ShowCursor(sdl.SDL_DISABLE)
        self._texture = sdl.SDL_CreateTexture(
            self._renderer, sdl.SDL_PIXELFORMAT_RGB24, sdl.SDL_TEXTUREACCESS_STREAMING, *self._size
        )
        self.show(bytes(self.frame_bytes))
        self.vsync_s = self._locked_period_s(self.display.refresh_hz)

    def show(self, frame: bytes, refreshes: int | None = None) -> None:
        """Show a frame and wait until it is transmitted."""
        self._upload(frame)
        self._draw()
        if self._read_back() != frame:
            raise ScreenError(
                "the drawn pixels differ from the frame", "set the display to 24 bits per pixel, unscaled"
            )
        if refreshes is not None:
            black = bytes(self.frame_bytes)
            self._upload(black)
            self._present()  # what follows begins with a refresh
            self._upload(frame)
            for _ in range(refreshes):
                self._present()
            self._upload(black)
        for _ in range(1 + QUEUED_FRAMES):
            self._present()
        self.process_events()

    def process_events(self) -> None:
        """Process window events and check that the frame is still visible."""
        sdl, event = self._sdl, self._sdl.SDL_Event()
        while sdl.SDL_PollEvent(byref(event)):
            if event.type == sdl.SDL_QUIT:
                raise ScreenError("its window was closed", "open it again")
            if event.type == sdl.SDL_WINDOWEVENT and event.window.event == sdl.SDL_WINDOWEVENT_EXPOSED:
                self._present()
        hidden = sdl.SDL_WINDOW_HIDDEN | sdl.SDL_WINDOW_MINIMIZED
        if sdl.SDL_GetWindowFlags(self._window) & hidden:
            raise ScreenError("its window was hidden", "leave the projector's display alone")
        self._check_placement()

    def _create_window(self, index: int) -> tuple[Any, Any]:
        sdl = self._sdl
        at = sdl.SDL_WINDOWPOS_UNDEFINED_MASK | index
        flags = sdl.SDL_WINDOW_FULLSCREEN_DESKTOP | sdl.SDL_WINDOW_ALLOW_HIGHDPI
        window = sdl.SDL_CreateWindow(b"fpplab", at, at, *self._size, flags)
        renderer = window and sdl.SDL_CreateRenderer(window, -1, sdl.SDL_RENDERER_PRESENTVSYNC)
        if not renderer or sdl.SDL_RenderSetVSync(renderer, 1):
            raise ScreenError(f"the display cannot be filled ({sdl.SDL_GetError().decode()})")
        return renderer, window

    def _check_placement(self) -> None:
        if self._sdl.SDL_GetWindowDisplayIndex(self._window) != self.display.index:
            raise ScreenError("its window is on another display", "leave the projector's display alone")
        width, height = c_int(), c_int()
        self._sdl.SDL_GetRendererOutputSize(self._renderer, byref(width), byref(height))
        size = (width.value, height.value)
        if size != self._size:
            is_scaled = size[0] * self._size[1] == size[1] * self._size[0]
            raise ScreenError(
                "its window has {} x {} pixels, not {} x {}".format(*size, *self._size),
                "the desktop scales the display: set its scaling to 100 %" if is_scaled else REMEDY,
            )

    def _upload(self, frame: bytes) -> None:
        if self._sdl.SDL_UpdateTexture(self._texture, None, frame, 3 * self._size[0]):
            raise ScreenError(f"a frame cannot be shown ({self._sdl.SDL_GetError().decode()})")

    def _draw(self) -> None:
        self._sdl.SDL_RenderCopy(self._renderer, self._texture, None, None)

    def _read_back(self) -> bytes:
        pixels = create_string_buffer(self.frame_bytes)
        form, pitch = self._sdl.SDL_PIXELFORMAT_RGB24, 3 * self._size[0]
        self._sdl.SDL_RenderReadPixels(self._renderer, None, form, pixels, pitch)
        return pixels.raw

    def _present(self) -> None:
        self._draw()
        self._sdl.SDL_RenderPresent(self._renderer)

    def _locked_period_s(self, reported_hz: int) -> float:
        """Return the refresh period: as the display reports it, if frames follow it; else as measured."""
        # Raises `ScreenError` when frames are presented faster than the display shows them.
        times = []
        for _ in range(11):
            self._present()
            times.append(time.perf_counter())
        measured_s = median(b - a for a, b in pairwise(times))
        if not reported_hz:
            return measured_s
        if measured_s < MIN_SHARE_OF_PERIOD / reported_hz:
            raise ScreenError(
                f"frames come every {1e3 * measured_s:.1f} ms on a display of {reported_hz} Hz",
                "switch on vertical synchronisation in the graphics driver",
            )
        return vsync_period_s(reported_hz)


def _choose_display(
    displays: list[DisplayInfo], display_id: int | str, size: tuple[int, int] | None
) -> DisplayInfo:
    """The display asked for, or `ScreenError` unless exactly one of the right size matches."""
    listed = ", ".join(map(str, displays))
    matching = [display for display in displays if display_id in (display.index, display.name)]
    if not matching:
        raise ScreenError(f"there is no display {display_id!r}", f"there are {listed}")
    if len(matching) > 1:
        raise ScreenError(f"several displays are called {display_id!r}", f"name one by its number: {listed}")
    if size is not None and matching[0].size != size:
        raise ScreenError(
            "display {!r} is not set to {} x {}".format(display_id, *size), f"set it so; there are {listed}"
        )
    return matching[0]


def vsync_period_s(reported_hz: int) -> float:
    """Compute the refresh period from a reported rate, correcting television rates such as 59.94 Hz."""
    return 1.0 / (reported_hz + (reported_hz + 1 in WHOLE_RATES_HZ))
