"""The emulated controller as a USB device of this computer, through the kernel's own USB/IP hub.

The kernel's module vhci-hcd takes one end of a socket pair for a cable, and says on it what its drivers want
of the device. To every program the projector is then on USB, as real as any; only its descriptors are
assumptions (see `descriptors`).

Source: Linux, Documentation/usb/usbip_protocol.rst and drivers/usb/usbip/vhci_sysfs.c.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import struct
import threading
from collections import defaultdict, deque
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from drivers.dlp4500.transport import INTERFACE, PRODUCT, VENDOR
from drivers.emulators.dlpc350.descriptors import FULL_SPEED, INWARDS, Introduction, endpoint_in, endpoint_out
from drivers.emulators.dlpc350.usb import EmulatedHid
from fpplab.core.errors import DeviceError

HUB = Path("/sys/devices/platform/vhci_hcd.0")
NAME = "emulator"
POLL_S = 0.002
_SUBMIT, _UNLINK, _SUBMITTED, _UNLINKED = 1, 2, 3, 4
_HEADER_BYTES = 48
_DEVICE_ID = 1 << 16 | 2
"""Bus and number at the far end, where there are none."""
_FREE = "004"
"""State of a port of the hub."""


class Conversation:
    """What the kernel and one plugged-in device say to each other over a socket.

    Requests for reports wait here until there is one.
    """

    def __init__(self, hid: EmulatedHid, near: socket.socket) -> None:
        self._socket = near
        found = hid.enumerate(VENDOR, PRODUCT)
        (path,) = (one["path"] for one in found if one["interface_number"] == INTERFACE)
        self._device = hid.device()
        self._device.open_path(path)
        self._introduction = Introduction(hid.serial)
        self._waiting: dict[int, deque[tuple[int, int]]] = defaultdict(deque)

    def take(self) -> bool:
        """Do the next thing that the kernel asks for; False when it has let go of the device."""
        head = self._received(_HEADER_BYTES)
        if not head:
            return False
        command, number, _, inwards, endpoint = struct.unpack(">5I", head[:20])
        if command == _UNLINK:
            self._unlink(number, int.from_bytes(head[20:24], "big"))
            return True
        length = int.from_bytes(head[24:28], "big")
        if inwards:
            endpoint |= INWARDS
        data = self._received(length) if length and not inwards else b""
        if endpoint & ~INWARDS == 0:
            self._control(number, head[40:48], bool(inwards), length)
        elif inwards:
            self._waiting[endpoint].append((number, length))
        else:
            if endpoint == endpoint_out(INTERFACE):
                self._device.write(b"\0" + data)
            self._done(number, length)
        return True

    def give(self) -> None:
        """Hand over the reports that are there and are waited for."""
        waiting = self._waiting[endpoint_in(INTERFACE)]
        while waiting and self._device.has_report():
            number, length = waiting.popleft()
            report = bytes(self._device.read(length, 1))
            self._done(number, len(report), report)

    def _received(self, count: int) -> bytes:
        try:
            data = self._socket.recv(count, socket.MSG_WAITALL)
        except ConnectionError:
            return b""
        return data if len(data) == count else b""

    def _control(self, number: int, setup: bytes, inwards: bool, length: int) -> None:
        told = self._introduction.answer(setup)
        if told is None:
            self._done(number, 0, status=-errno.EPIPE)
        else:
            self._done(number, len(told) if inwards else length, told)

    def _unlink(self, number: int, unwanted: int) -> None:
        found = False
        for waiting in self._waiting.values():
            for request in [r for r in waiting if r[0] == unwanted]:
                waiting.remove(request)
                found = True
        status = -errno.ECONNRESET if found else 0
        self._say(struct.pack(">IIIIIi24x", _UNLINKED, number, 0, 0, 0, status))

    def _done(self, number: int, actual: int, data: bytes = b"", status: int = 0) -> None:
        self._say(struct.pack(">IIIIIii20x", _SUBMITTED, number, 0, 0, 0, status, actual) + data)

    def _say(self, data: bytes) -> None:
        with suppress(ConnectionError):  # the kernel has let go meanwhile: `take` finds out
            self._socket.sendall(data)


class PluggedIn:
    """The controller on this computer's USB between `with PluggedIn(hid)` and its end, in real time.

    It leaves the bus and comes back as `hid` does: unplugged, or in a reset. lock: keeps the controller still
    while somebody looks at it. Raises `DeviceError` on entry where the kernel has no such hub or does not let
    this user plug in.
    """

    def __init__(self, hid: EmulatedHid) -> None:
        self.hid, self.lock = hid, threading.RLock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Self:
        self._plug_in()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def _plug_in(self) -> None:
        near, far = socket.socketpair()
        with far, ExitStack() as failing:
            failing.enter_context(near)
            attach(far)
            failing.pop_all()
        self._socket, self._plug = near, self.hid.plugs
        self._conversation = Conversation(self.hid, near)

    def _serve(self) -> None:
        while not self._ended.is_set():
            with self._socket:
                self._follow()
            while not self._ended.wait(POLL_S):
                with self.lock:
                    if self.hid.is_plugged:
                        self._plug_in()
                        break

    def _follow(self) -> None:
        """Serve the kernel until the cable is out, at either end."""
        while not self._ended.is_set() and self.hid.plugs == self._plug:
            asked, _, _ = select.select([self._socket], [], [], POLL_S)
            with self.lock:
                self.hid.controller.advance()
                if asked and not self._conversation.take():
                    self.hid.unplug()
                self._conversation.give()


def attach(cable: socket.socket) -> None:
    """Plug a cable into the kernel's hub. Raises `DeviceError` when there is none, or no right to it."""
    if not HUB.is_dir():
        raise DeviceError(
            NAME,
            "plug in",
            f"the kernel has no USB/IP hub ({HUB} is missing)",
            "on Linux: sudo modprobe vhci-hcd; other systems have none",
        )
    order = f"{free_port()} {cable.fileno()} {_DEVICE_ID} {FULL_SPEED}"
    try:
        with open(HUB / "attach", "w", encoding="ascii") as file:
            file.write(order)
    except PermissionError as error:
        raise DeviceError(
            NAME, "plug in", f"user {os.getuid()} may not write {HUB}/attach", "start it with sudo"
        ) from error
    except OSError as error:
        raise DeviceError(NAME, "plug in", f"the kernel's USB/IP hub refuses ({error.strerror})") from error


def free_port() -> int:
    """A port of the hub for a device of full speed. Raises `DeviceError` when all are taken."""
    for line in (HUB / "status").read_text("ascii").splitlines()[1:]:
        hub, port, state, *_ = line.split()
        if hub == "hs" and state == _FREE:
            return int(port)
    raise DeviceError(NAME, "plug in", "every port of the kernel's USB/IP hub is taken", "end what uses it")
