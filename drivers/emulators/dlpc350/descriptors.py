"""USB descriptors of the emulated controller, and its answers to standard control requests.

Documented are vendor and product, that several HID interfaces may show of which number 0 takes commands, and
its endpoints 0x01 and 0x81 of 64 bytes. All else is assumed, until `lsusb -v` of a board replaces it: a
second interface with endpoints of its own, full speed, names, version numbers and report descriptors.

References
----------
USB 2.0, chapter 9; HID 1.11, sections 6.2 and 7.
"""

from __future__ import annotations

import struct

from drivers.dlp4500.framing import REPORT_BYTES
from drivers.dlp4500.transport import INTERFACE, PRODUCT, VENDOR

FULL_SPEED = 2
"""The kernel's number for 12 Mbit/s."""
INWARDS = 0x80
"""Bit of an endpoint's address and of a request's type: data goes to the computer."""
INTERFACES = (INTERFACE, INTERFACE + 1)
"""Numbers of the HID interfaces."""
_STANDARD, _CLASS = 0x00, 0x20
_KIND = 0x60
_DEVICE, _CONFIGURATION, _STRING, _HID, _REPORT = 1, 2, 3, 0x21, 0x22
_GET_DESCRIPTOR, _GET_STATUS = 6, 0
_CLEAR_FEATURE, _SET_CONFIGURATION, _SET_INTERFACE = 1, 9, 11
_SET_IDLE = 10
_ENGLISH = b"\x09\x04"

REPORTS = bytes.fromhex(
    "0600ff 0901 a101"  # of the vendor's own page
    "1500 26ff00 7508 9540 0902 8102"  # 64 bytes in
    "1500 26ff00 7508 9540 0903 9102"  # 64 bytes out
    "c0"
)
"""HID report descriptor of every interface: vendor page, 64 bytes in each direction."""


def endpoint_out(interface: int) -> int:
    """Return the address of the endpoint to which an interface's reports are sent."""
    return 1 + interface


def endpoint_in(interface: int) -> int:
    """Return the address of the endpoint from which an interface's reports are read."""
    return INWARDS | endpoint_out(interface)


def _hid() -> bytes:
    return struct.pack("<BBHBBBH", 9, _HID, 0x0111, 0, 1, _REPORT, len(REPORTS))


def _endpoint(address: int) -> bytes:
    interrupt, every_ms = 3, 1
    return struct.pack("<BBBBHB", 7, 5, address, interrupt, REPORT_BYTES, every_ms)


def _configuration() -> bytes:
    body = b""
    for number in INTERFACES:
        body += bytes([9, 4, number, 0, 2, 3, 0, 0, 0]) + _hid()
        body += _endpoint(endpoint_in(number)) + _endpoint(endpoint_out(number))
    self_powered, units_of_2_ma = 0xC0, 50
    head = (9, _CONFIGURATION, 9 + len(body), len(INTERFACES), 1, 0, self_powered, units_of_2_ma)
    return struct.pack("<BBHBBBBB", *head) + body


class ControlEndpoint:
    """Answers the control requests to endpoint 0."""

    def __init__(self, serial: str) -> None:
        device = struct.pack(
            "<BBHBBBBHHHBBBB", 18, _DEVICE, 0x0110, 0, 0, 0, 64, VENDOR, PRODUCT, 0x0100, 1, 2, 3, 1
        )
        names = [_ENGLISH, *(name.encode("utf-16le") for name in ("Texas Instruments", "DLPC350", serial))]
        self._descriptors = {
            _DEVICE << 8: device,
            _CONFIGURATION << 8: _configuration(),
            _HID << 8: _hid(),
            _REPORT << 8: REPORTS,
        } | {_STRING << 8 | i: bytes([2 + len(name), _STRING]) + name for i, name in enumerate(names)}

    def answer(self, setup: bytes) -> bytes | None:
        """Answer a control request."""
        kind, request, value, _, length = struct.unpack("<BBHHH", setup)
        if kind & INWARDS:
            if kind & _KIND != _STANDARD:
                return None
            data = {_GET_STATUS: b"\1\0", _GET_DESCRIPTOR: self._descriptors.get(value)}.get(request)
            return None if data is None else data[:length]
        orders = {_STANDARD: (_CLEAR_FEATURE, _SET_CONFIGURATION, _SET_INTERFACE), _CLASS: (_SET_IDLE,)}
        return b"" if request in orders.get(kind & _KIND, ()) else None
