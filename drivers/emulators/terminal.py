"""A pseudo-terminal with an emulated device at its far end: programs open it as they open a serial port."""

import os
import select
import threading
from types import TracebackType
from typing import Protocol, Self

from fpplab.core.errors import DeviceError
from fpplab.core.system import posix, system_module

POLL_S = 0.002  # longest time in s between two queries of the emulated device (chosen)


class SerialEmulator(Protocol):
    """An emulated device that is connected by a serial line.

    `PseudoTerminal` calls both methods from its own thread while it holds its lock.
    """

    def receive(self, data: bytes) -> None:
        """Take bytes from the line; called whenever there are some."""

    def poll(self) -> bytes:
        """Advance to the present time and return what there is to send; called at least every `POLL_S`."""


class PseudoTerminal:
    """Serves a device while its context is entered, in a thread of its own.

    Baud rate and parity do not matter, since there is no wire. Bytes that no program reads are lost, as on a
    serial line. Entering raises `DeviceError` where the system has no pseudo-terminals.
    """

    def __init__(self, device: SerialEmulator) -> None:
        self.device, self.lock = device, threading.Lock()
        self.port = ""
        self._served = threading.Thread(target=self._serve, daemon=True)
        self._plugged = False

    def __enter__(self) -> Self:
        tty = system_module("tty")
        if tty is None:
            raise DeviceError("emulator", "open", "this system has no pseudo-terminals", "use Linux or macOS")
        self._near, self._far = posix.openpty()
        tty.setraw(self._far)  # or the system would echo the device's output back to it
        posix.set_blocking(self._near, False)
        self.port, self._plugged = posix.ttyname(self._far), True
        self._served.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.unplug()
        self._served.join()

    def unplug(self) -> None:
        """Unplug the cable for good; the device itself may call it too."""
        self._plugged = False

    def _serve(self) -> None:
        while self._plugged:
            ready, _, _ = select.select([self._near], [], [], POLL_S)
            with self.lock:
                if ready:
                    self.device.receive(os.read(self._near, 4096))
                self._send(self.device.poll())
        os.close(self._near)
        os.close(self._far)

    def _send(self, data: bytes) -> None:
        while data and self._plugged:
            try:
                data = data[os.write(self._near, data) :]
            except BlockingIOError:
                return  # no program reads: the bytes are lost, as on a serial line
