"""A display of this computer that holds one frame at a time: of a projector, or of its video port."""

import multiprocessing
from contextlib import suppress
from multiprocessing.process import BaseProcess
from multiprocessing.shared_memory import SharedMemory
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.apart import ask_apart, main_left_out
from drivers.display import screen
from drivers.display.screen import DisplayInfo, OpenedScreen, ShowFrame
from fpplab.core.errors import DeviceError, DeviceTimeoutError, DisconnectedError
from fpplab.core.extras import need_extra

START_S, SHOW_S, STOP_S = 30.0, 5.0, 5.0
"""Time limits in s for the process to open the display, to show a frame, and to end (chosen)."""

VideoFrame = NDArray[np.uint8]  # uint8 (height, width, 3): red, green, blue


class Display(Protocol):
    """A display that a projector shows, or that its video port is connected to."""

    vsync_s: float  # period of the video frames in s; known once open

    def open(self) -> None:
        """Open the display and show black, or raise `DeviceError` when that is not possible."""

    def show(self, frame: VideoFrame) -> None:
        """Show a frame (height, width, 3) of red, green, blue; return when it is transmitted."""

    def close(self) -> None:
        """Close the display; may be called at any time, any number of times."""


class SdlDisplay:
    """A full-screen window through SDL, in a process of its own, for SDL needs the main thread."""

    def __init__(self, name: str, display_id: int | str, size: tuple[int, int] | None) -> None:
        self._name, self._display_id, self._size = name, display_id, size
        self.vsync_s = 0.0
        self.info: DisplayInfo | None = None
        self._process: BaseProcess | None = None
        self._connection: Any = None  # a `Connection`, of a kind that differs between systems
        self._memory: SharedMemory | None = None

    @property
    def pid(self) -> int | None:
        return self._process.pid if self._process is not None else None

    def open(self) -> None:
        need_extra("sdl2")
        self.close()
        context = multiprocessing.get_context("spawn")  # SDL and threads do not survive a fork
        self._connection, theirs = context.Pipe()
        try:
            self._process = context.Process(
                target=screen.serve_screen,
                args=(theirs, self._display_id, self._size),
                name="display",
                daemon=True,
            )
            with main_left_out():
                self._process.start()
        finally:
            theirs.close()  # so that the pipe ends when the process does
        opened: OpenedScreen = self._wait_for_answer("open", START_S)
        self.vsync_s, self.info = opened.vsync_s, opened.display
        width, height = opened.display.size
        self._shape = (height, width, 3)
        self._memory = SharedMemory(create=True, size=int(np.prod(self._shape)))
        self._connection.send(self._memory.name)

    def show(self, frame: VideoFrame, refreshes: int | None = None) -> None:
        """Show one frame; return when it is transmitted. A device error closes the display."""
        # frame (height, width, 3)
        if self._connection is None or self._memory is None:
            raise DisconnectedError(self._name, "video", "its display is not open", "open it first")
        if frame.shape != self._shape or frame.dtype != np.uint8:
            raise ValueError(f"a frame is uint8 {self._shape}, not {frame.dtype} {frame.shape}")
        np.copyto(np.ndarray(self._shape, np.uint8, self._memory.buf), frame)
        with suppress(OSError):  # an answer sent before the process ended is still to be read
            self._connection.send(ShowFrame(refreshes))
        self._wait_for_answer("video", SHOW_S + (refreshes or 0) * self.vsync_s)

    def close(self) -> None:
        """Close the display and end the process; may be called at any time, any number of times."""
        if self._connection is not None:
            self._connection.close()  # which ends the process
        if self._process is not None and self._process.pid is not None:
            self._process.join(STOP_S)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()
            self._process.close()
        if self._memory is not None:
            self._memory.close()
            self._memory.unlink()
        self._process = self._connection = self._memory = None

    def _wait_for_answer(self, operation: str, timeout_s: float) -> Any:
        """Wait for the process's answer; any failure, including an interruption, ends the process."""
        assert self._connection is not None
        try:
            if not self._connection.poll(timeout_s):
                raise DeviceTimeoutError(
                    self._name,
                    operation,
                    f"its display did not answer within {timeout_s:g} s",
                    "try it again",
                )
            answer = self._connection.recv()
            if isinstance(answer, screen.ScreenFailure):
                raise DeviceError(self._name, operation, answer.reason, answer.remedy)
            return answer
        except (OSError, EOFError) as error:
            raise self._process_ended_error(operation) from error
        except BaseException:
            self.close()
            raise

    def _process_ended_error(self, operation: str) -> DisconnectedError:
        assert self._process is not None
        self._process.join(STOP_S)
        code = self._process.exitcode
        self.close()
        return DisconnectedError(
            self._name, operation, f"the process of its display has died (exit code {code})", "open it again"
        )


def connected_displays() -> list[DisplayInfo]:
    need_extra("sdl2")
    answer = ask_apart(screen.serve_displays, timeout_s=START_S)
    if isinstance(answer, screen.ScreenFailure):
        raise DeviceError("displays", "list", answer.reason, answer.remedy)
    if answer is None:
        raise DeviceError("displays", "list", "SDL does not answer", "check that the graphical session runs")
    listed: list[DisplayInfo] = answer
    return listed
