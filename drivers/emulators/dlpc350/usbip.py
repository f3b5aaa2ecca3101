"""The emulated controller as a USB device of this computer, through the kernel's own USB/IP hub.

The kernel's module vhci-hcd takes one end of a socket pair in place of a cable, and sends over it the
requests of its drivers. To every program the projector is then an ordinary USB device; only its descriptors
are assumptions (see `descriptors`).

Source: Linux, Documentation/usb/usbip_protocol.rst and drivers/usb/usbip/vhci_sysfs.c.
"""

import errno
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
from drivers.emulators.dlpc350.descriptors import INWARDS, ControlEndpoint, endpoint_in, endpoint_out
from drivers.emulators.dlpc350.usb import EmulatedHid
from fpplab.core.errors import DeviceError
from fpplab.core.system import posix

HUB = Path("/sys/devices/platform/vhci_hcd.0")  # directory of the virtual hub in sysfs
NAME = "emulator"  # name of the device in error messages
POLL_S = 0.002
"""Longest time in s between two queries of the emulated device (chosen: two reports at full speed)."""
_SUBMIT, _UNLINK, _SUBMITTED, _UNLINKED = 1, 2, 3, 4  # numbers of the commands (usbip_protocol.rst)


class UsbIpConnection:
    """The USB/IP protocol between the kernel and a plugged-in device; requests for reports wait for one."""

    def __init__(self, hid: EmulatedHid, device_end: socket.socket) -> None:
        self._socket = device_end
        interfaces = hid.enumerate(VENDOR, PRODUCT)
        (path,) = (
            interface["path"] for interface in interfaces if interface["interface_number"] == INTERFACE
        )
        self._device = hid.device()
        self._device.open_path(path)
        self._control_endpoint = ControlEndpoint(hid.serial)
        self._pending: dict[int, deque[tuple[int, int]]] = defaultdict(deque)

    def handle_request(self) -> bool:
        head = self._received(48)  # the size of every header
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
            self._pending[endpoint].append((number, length))
        else:
            if endpoint == endpoint_out(INTERFACE):
                self._device.write(b"\0" + data)
            self._complete(number, length)
        return True

    def deliver_reports(self) -> None:
        """Complete the waiting requests for which there are reports."""
        pending = self._pending[endpoint_in(INTERFACE)]
        while pending and self._device.has_report():
            number, length = pending.popleft()
            report = bytes(self._device.read(length, 1))
            self._complete(number, len(report), report)

    def _received(self, count: int) -> bytes:
        try:
            data = self._socket.recv(count, socket.MSG_WAITALL)
        except ConnectionError:
            return b""
        return data if len(data) == count else b""

    def _control(self, number: int, setup: bytes, inwards: bool, length: int) -> None:
        data = self._control_endpoint.answer(setup)
        if data is None:
            self._complete(number, 0, status=-errno.EPIPE)
        else:
            self._complete(number, len(data) if inwards else length, data)

    def _unlink(self, number: int, unwanted: int) -> None:
        was_pending = False
        for pending in self._pending.values():
            for request in [r for r in pending if r[0] == unwanted]:
                pending.remove(request)
                was_pending = True
        status = -errno.ECONNRESET if was_pending else 0
        self._send(struct.pack(">IIIIIi24x", _UNLINKED, number, 0, 0, 0, status))

    def _complete(self, number: int, actual: int, data: bytes = b"", status: int = 0) -> None:
        self._send(struct.pack(">IIIIIii20x", _SUBMITTED, number, 0, 0, 0, status, actual) + data)

    def _send(self, data: bytes) -> None:
        with suppress(ConnectionError):  # the kernel has closed the connection: `handle_request` will notice
            self._socket.sendall(data)


class UsbIpAttachment:
    """The controller on this computer's USB while its context is entered, in real time.

    It leaves the bus and comes back as `hid` does: unplugged, or in a reset. Entering raises `DeviceError` if
    the kernel has no such hub or does not let this user attach a device.
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
        device_end, kernel_end = socket.socketpair()
        with kernel_end, ExitStack() as failing:
            failing.enter_context(device_end)
            attach(kernel_end)
            failing.pop_all()
        self._socket, self._plug = device_end, self.hid.plugs
        self._connection = UsbIpConnection(self.hid, device_end)

    def _serve(self) -> None:
        while not self._ended.is_set():
            with self._socket:
                self._serve_connection()
            while not self._ended.wait(POLL_S):
                with self.lock:
                    if self.hid.is_plugged:
                        self._plug_in()
                        break

    def _serve_connection(self) -> None:
        """Serve the kernel until the cable is unplugged at either end."""
        while not self._ended.is_set() and self.hid.plugs == self._plug:
            readable, _, _ = select.select([self._socket], [], [], POLL_S)
            with self.lock:
                self.hid.controller.advance()
                if readable and not self._connection.handle_request():
                    self.hid.unplug()
                self._connection.deliver_reports()


def attach(cable: socket.socket, speed: int = 2) -> None:
    """Attach one end of a socket pair to the kernel's hub; 2 is its number for full speed, 12 Mbit/s."""
    if not HUB.is_dir():
        raise DeviceError(
            NAME,
            "plug in",
            f"the kernel has no USB/IP hub ({HUB} is missing)",
            "on Linux: sudo modprobe vhci-hcd; other systems have none",
        )
    remote_device = 1 << 16 | 2  # bus and number at the other end, which have no meaning here
    order = f"{free_port()} {cable.fileno()} {remote_device} {speed}"
    try:
        with open(HUB / "attach", "w", encoding="ascii") as file:
            file.write(order)
    except PermissionError as error:
        raise DeviceError(
            NAME, "plug in", f"user {posix.getuid()} may not write {HUB}/attach", "start it with sudo"
        ) from error
    except OSError as error:
        raise DeviceError(NAME, "plug in", f"the kernel's USB/IP hub refuses ({error.strerror})") from error


def free_port() -> int:
    """Find a free port of the hub for a device of full or high speed."""
    for line in (HUB / "status").read_text("ascii").splitlines()[1:]:
        hub, port, state, *_ = line.split()
        if hub == "hs" and state == "004":  # VDEV_ST_NULL: free
            return int(port)
    raise DeviceError(
        NAME, "plug in", "every port of the kernel's USB/IP hub is taken", "detach a device from it"
    )
