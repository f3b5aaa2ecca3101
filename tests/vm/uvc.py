"""A USB camera on the guest's USB, in a process of its own: the kernel's UVC driver makes /dev/video… of it.

It runs freely, and is found with automatic exposure, a gamma and some gain, as a webcam is. A frame shows
what was lit when its exposure began; one for which the kernel has no room, or that is late by more than a
frame because this process was held up, is lost.
"""

import errno
import select
import socket
import struct
import threading
import time
from collections import deque
from contextlib import suppress
from multiprocessing.managers import BaseManager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.emulators.dlpc350.usbip import attach
from tests.vm.uvc_descriptors import (
    DESCRIPTORS,
    EXPOSURE,
    EXPOSURE_MODE,
    FORMATS,
    GAIN,
    GAMMA,
    HEADER_BYTES,
    PERIOD_100_NS,
    REFERENCE_EXPOSURE_S,
    probe,
)

ADDRESS = "/run/uvc.socket"
HIGH_SPEED = 3
INFO, LENGTH, CURRENT, SET = 0x86, 0x85, 0x81, 0x01
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
AUTOMATIC = 8
"""The exposure mode that it begins with: aperture priority."""
LIMITS = {
    EXPOSURE_MODE: ("B", {0x82: 1, 0x83: 9, 0x84: 9, 0x87: AUTOMATIC}),
    EXPOSURE: ("I", {0x82: 1, 0x83: 2000, 0x84: 1, 0x87: 157}),
    GAIN: ("H", {0x82: 0, 0x83: 120, 0x84: 1, 0x87: 0}),
    GAMMA: ("H", {0x82: 72, 0x83: 500, 0x84: 1, 0x87: 120}),
}
"""Type of each control, and its least and greatest value, step (or modes) and default by request."""


class UvcCamera:
    """The camera."""

    def __init__(self) -> None:
        self._values = {EXPOSURE_MODE: AUTOMATIC, EXPOSURE: 157, GAIN: 40, GAMMA: 220}
        self._probe = probe(1)
        self._lit: deque[tuple[float, NDArray[Any]]] = deque([(0.0, np.zeros((32, 48)))], maxlen=50)
        self._waiting: deque[int] = deque()
        self._end_s, self._parity, self._socket = 0.0, 0, None

    def plug(self) -> None:
        """Put it on the bus, unless it is there."""
        if self._socket is not None:
            return
        self._socket, kernel_end = socket.socketpair()
        with kernel_end:
            attach(kernel_end, HIGH_SPEED)
        threading.Thread(target=self._serve, args=(self._socket,), daemon=True).start()

    def unplug(self) -> None:
        """Take it off the bus."""
        unplugged, self._socket = self._socket, None
        if unplugged is not None:
            unplugged.shutdown(socket.SHUT_RDWR)

    def light(self, share: NDArray[Any]) -> None:
        """Light the sensor: shares of full scale at the reference exposure."""
        self._lit.append((time.monotonic(), share))

    def values(self) -> list[int]:
        """Exposure mode, exposure, gain and gamma."""
        return list(self._values.values())

    def _serve(self, wire: socket.socket) -> None:
        self._waiting.clear()
        with wire, suppress(ConnectionError):
            while self._socket is wire:
                asked, _, _ = select.select([wire], [], [], 0.001)
                if asked and not self._handle(wire):
                    break
                self._expose(wire)
        if self._socket is wire:
            self._socket = None

    def _handle(self, wire: socket.socket) -> bool:
        head = wire.recv(48, socket.MSG_WAITALL)
        if len(head) < 48:
            return False
        command, number, _, inwards, endpoint = struct.unpack(">5I", head[:20])
        if command == UNLINK:
            unwanted = int.from_bytes(head[20:24], "big")
            found = unwanted in self._waiting
            if found:
                self._waiting.remove(unwanted)
            status = -errno.ECONNRESET if found else 0
            wire.sendall(struct.pack(">IIIIIi24x", UNLINKED, number, 0, 0, 0, status))
            return True
        length = int.from_bytes(head[24:28], "big")
        data = wire.recv(length, socket.MSG_WAITALL) if length and not inwards else b""
        if endpoint:
            self._waiting.append(number)
        else:
            answer = self._answer(head[40:48], data)
            status = -errno.EPIPE if answer is None else 0
            self._complete(wire, number, answer or b"", status, 0 if inwards else length)
        return True

    @staticmethod
    def _complete(wire: socket.socket, number: int, data: bytes, status: int = 0, taken: int = 0) -> None:
        head = struct.pack(">IIIIIii20x", SUBMITTED, number, 0, 0, 0, status, len(data) or taken)
        wire.sendall(head + data)

    def _answer(self, setup: bytes, data: bytes) -> bytes | None:
        kind, request, value, index, length = struct.unpack("<BBHHH", setup)
        if kind & 0x60 == 0:
            if kind & 0x80:
                found = DESCRIPTORS.get(value) if request == 6 else b"\0\0"
                return None if found is None else found[:length]
            return b""
        unit, selector = index >> 8, value >> 8
        answer = (
            self._of_stream(request, data) if not unit else self._of_unit((unit, selector), request, data)
        )
        return None if answer is None else answer[:length]

    def _of_stream(self, request: int, data: bytes) -> bytes | None:
        if request == SET:
            self._probe = probe(data[2] if data[2] in FORMATS else 1)
            return b""
        return {INFO: b"\3", LENGTH: struct.pack("<H", len(self._probe))}.get(request, self._probe)

    def _of_unit(self, control: tuple[int, int], request: int, data: bytes) -> bytes | None:
        if control not in LIMITS:
            return None
        kind, limits = LIMITS[control]
        if request == SET:
            (value,) = struct.unpack(f"<{kind}", data)
            fits = (
                value in (1, AUTOMATIC) if control == EXPOSURE_MODE else limits[0x82] <= value <= limits[0x83]
            )
            automatic = control == EXPOSURE and self._values[EXPOSURE_MODE] == AUTOMATIC
            if not fits or automatic:
                return None
            self._values[control] = value
            return b""
        if request in (INFO, LENGTH):
            return b"\3" if request == INFO else struct.pack("<H", struct.calcsize(kind))
        return struct.pack(f"<{kind}", self._values[control] if request == CURRENT else limits[request])

    def _expose(self, wire: socket.socket) -> None:
        exposure_s = self._values[EXPOSURE] * 1e-4
        step = max(exposure_s, PERIOD_100_NS * 1e-7)
        now = time.monotonic()
        if now - self._end_s > 10 * step:
            self._end_s = now
        while self._end_s + step <= now:
            self._end_s += step
            if self._waiting:
                self._send(wire, self._payload(exposure_s), latest_s=self._end_s + step)

    def _send(self, wire: socket.socket, payload: bytes, latest_s: float) -> None:
        """A frame, which the kernel stamps when it comes."""
        if time.monotonic() < latest_s:
            self._complete(wire, self._waiting.popleft(), payload)
            self._parity ^= 1

    def _payload(self, exposure_s: float) -> bytes:
        begin_s = self._end_s - exposure_s
        lit = next((share for since_s, share in reversed(self._lit) if since_s <= begin_s), self._lit[0][1])
        bits = FORMATS[self._probe[2]][1]
        gain = exposure_s / REFERENCE_EXPOSURE_S * 10 ** (0.1 * self._values[GAIN] / 20)
        full = (1 << bits) - 1
        image = np.rint(np.clip(lit * gain, 0.0, 1.0) * full).astype("<u1" if bits == 8 else "<u2")
        return bytes([HEADER_BYTES, 0x80 | 2 | self._parity]) + image.tobytes()


class Wires(BaseManager):
    """How the tests reach the camera's process."""


def connected() -> UvcCamera:
    """Control the camera of this guest from another process."""
    Wires.register("camera")
    wires = Wires(ADDRESS, authkey=b"guest")
    wires.connect()
    camera: UvcCamera = wires.camera()  # type: ignore[attr-defined]
    return camera


def serve() -> None:
    """Run the camera's process until it is killed."""
    camera = UvcCamera()
    Wires.register("camera", callable=lambda: camera)
    Wires(ADDRESS, authkey=b"guest").get_server().serve_forever()


if __name__ == "__main__":
    serve()
