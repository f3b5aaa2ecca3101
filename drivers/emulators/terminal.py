"""A pseudo-terminal with an emulated device at the far end: programs open it as they open a serial port."""

from __future__ import annotations

import os
import select
import threading
from types import TracebackType
from typing import Protocol, Self

from fpplab.core.errors import DeviceError

POLL_S = 0.002


class SerialEmulator(Protocol):
    """A device that is spoken to byte by byte."""

    def receive(self, data: bytes) -> None:
        """Take what came over the wire."""

    def poll(self) -> bytes:
        """Let time pass, and return what there is to say."""


class PseudoTerminal:
    """Serves a device between `with Terminal(device) as terminal:` and its end, in a thread of its own.

    `port` is what a program opens; `lock` keeps the device still while a test looks at it. Speed and parity
    are whatever the program likes, since there is no wire. Raises `DeviceError` where the system has no
    pseudo-terminals.
    """

    def __init__(self, device: SerialEmulator) -> None:
        self.device, self.lock = device, threading.Lock()
        self.port = ""
        self._served = threading.Thread(target=self._serve, daemon=True)
        self._plugged = False

    def __enter__(self) -> Self:
        if os.name != "posix":
            raise DeviceError("emulator", "open", "this system has no pseudo-terminals", "use Linux or macOS")
        import tty

        self._near, self._far = os.openpty()
        tty.setraw(self._far)  # or the system would echo what the device says back to it
        os.set_blocking(self._near, False)
        self.port, self._plugged = os.ttyname(self._far), True
        self._served.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.unplug()
        self._served.join()

    def unplug(self) -> None:
        """Take the cable out, for good; may be called by the device itself."""
        self._plugged = False

    def _serve(self) -> None:
        while self._plugged:
            ready, _, _ = select.select([self._near], [], [], POLL_S)
            with self.lock:
                if ready:
                    self.device.receive(os.read(self._near, 4096))
                self._say(self.device.poll())
        os.close(self._near)
        os.close(self._far)

    def _say(self, data: bytes) -> None:
        while data and self._plugged:
            try:
                data = data[os.write(self._near, data) :]
            except BlockingIOError:
                return  # nobody reads: a serial line loses it as well
