"""A serial line with an emulated device at its far end: programs open it as they open a serial port."""

import os
import select
import socket
import threading
from contextlib import suppress
from types import TracebackType
from typing import Protocol, Self

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


class _Terminal:
    """A pseudo-terminal."""

    def __init__(self) -> None:
        self._near, self._far = posix.openpty()
        system_module("tty").setraw(self._far)  # or the system would echo the device's output back to it
        posix.set_blocking(self._near, False)
        self.port: str = posix.ttyname(self._far)

    def fileno(self) -> int:
        return int(self._near)

    def read(self) -> bytes:
        return os.read(self._near, 4096)

    def write(self, data: bytes) -> int:
        return os.write(self._near, data)

    def close(self) -> None:
        os.close(self._near)
        os.close(self._far)


class _Port:
    """A port of this computer, for systems without pseudo-terminals."""

    def __init__(self) -> None:
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._program: socket.socket | None = None
        self.port = f"socket://127.0.0.1:{self._listening.getsockname()[1]}"

    def fileno(self) -> int:
        return (self._program or self._listening).fileno()

    def read(self) -> bytes:
        if self._program is None:
            self._program = self._listening.accept()[0]
            self._program.setblocking(False)
            return b""
        with suppress(OSError):
            if data := self._program.recv(4096):
                return data
        self._program.close()
        self._program = None
        return b""

    def write(self, data: bytes) -> int:
        with suppress(ConnectionError):
            return self._program.send(data) if self._program else len(data)
        return len(data)

    def close(self) -> None:
        for each in (self._program, self._listening):
            if each is not None:
                each.close()


class PseudoTerminal:
    """Serves a device while its context is entered, in a thread of its own.

    Baud rate and parity do not matter, since there is no wire. Bytes that no program reads are lost, as on a
    serial line. Where the system has no pseudo-terminals, `port` is a socket's, which pyserial opens too.
    """

    def __init__(self, device: SerialEmulator) -> None:
        self.device, self.lock = device, threading.Lock()
        self.port = ""
        self._served = threading.Thread(target=self._serve, daemon=True)
        self._plugged = False

    def __enter__(self) -> Self:
        self._end = _Port() if system_module("tty") is None else _Terminal()
        self.port, self._plugged = self._end.port, True
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
            ready, _, _ = select.select([self._end], [], [], POLL_S)
            with self.lock:
                if ready and (data := self._end.read()):
                    self.device.receive(data)
                self._send(self.device.poll())
        self._end.close()

    def _send(self, data: bytes) -> None:
        while data and self._plugged:
            try:
                data = data[self._end.write(data) :]
            except BlockingIOError:
                return  # no program reads: the bytes are lost, as on a serial line
