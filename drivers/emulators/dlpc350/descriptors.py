"""USB descriptors of the emulated controller, and its answers to standard control requests.

Documented are vendor and product, that several HID interfaces may show of which number 0 takes commands, and
its endpoints 0x01 and 0x81 of 64 bytes. All else is assumed, until `lsusb -v` of a board replaces it: a
second interface with endpoints of its own, full speed, names, version numbers and report descriptors.

Source: USB 2.0, chapter 9; HID 1.11, sections 6.2 and 7.
"""

import struct
from enum import IntEnum

from drivers.dlp4500.framing import REPORT_BYTES
from drivers.dlp4500.transport import INTERFACE, PRODUCT, VENDOR

INWARDS = 0x80
"""Bit of an endpoint's address and of a request's type: data goes to the computer (USB 2.0, table 9-2)."""
INTERFACES = (INTERFACE, INTERFACE + 1)  # numbers of the HID interfaces


class Descriptor(IntEnum):
    """Types of descriptors (USB 2.0, table 9-5; HID 1.11, section 7.1)."""

    DEVICE = 1
    CONFIGURATION = 2
    STRING = 3
    INTERFACE = 4
    ENDPOINT = 5
    HID = 0x21
    REPORT = 0x22


class RequestKind(IntEnum):
    """Kinds of control requests, by two bits of their type (USB 2.0, table 9-2)."""

    STANDARD = 0x00
    CLASS = 0x20
    MASK = 0x60


class Request(IntEnum):
    """Standard requests (USB 2.0, table 9-4), and one of the HID class (HID 1.11, section 7.2)."""

    GET_STATUS = 0
    CLEAR_FEATURE = 1
    GET_DESCRIPTOR = 6
    SET_CONFIGURATION = 9
    SET_INTERFACE = 11
    HID_SET_IDLE = 10


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
    return struct.pack("<BBHBBBH", 9, Descriptor.HID, 0x0111, 0, 1, Descriptor.REPORT, len(REPORTS))


def _endpoint(address: int) -> bytes:
    interrupt, every_ms = 3, 1
    return struct.pack("<BBBBHB", 7, Descriptor.ENDPOINT, address, interrupt, REPORT_BYTES, every_ms)


def _configuration() -> bytes:
    endpoints, hid_class, no_subclass, no_protocol = 2, 3, 0, 0
    body = b""
    for number in INTERFACES:
        body += bytes([9, Descriptor.INTERFACE, number, 0, endpoints, hid_class, no_subclass, no_protocol, 0])
        body += _hid() + _endpoint(endpoint_in(number)) + _endpoint(endpoint_out(number))
    self_powered, units_of_2_ma = 0xC0, 50
    head = (9, Descriptor.CONFIGURATION, 9 + len(body), len(INTERFACES), 1, 0, self_powered, units_of_2_ma)
    return struct.pack("<BBHBBBBB", *head) + body


class ControlEndpoint:
    """Answers the control requests to endpoint 0."""

    def __init__(self, serial: str) -> None:
        device = struct.pack(
            "<BBHBBBBHHHBBBB", 18, Descriptor.DEVICE, 0x0110, 0, 0, 0, 64, VENDOR, PRODUCT, 0x0100, 1, 2, 3, 1
        )
        languages = b"\x09\x04"  # English (United States)
        names = [languages, *(name.encode("utf-16le") for name in ("Texas Instruments", "DLPC350", serial))]
        self._descriptors = {
            Descriptor.DEVICE << 8: device,
            Descriptor.CONFIGURATION << 8: _configuration(),
            Descriptor.HID << 8: _hid(),
            Descriptor.REPORT << 8: REPORTS,
        } | {
            Descriptor.STRING << 8 | i: bytes([2 + len(name), Descriptor.STRING]) + name
            for i, name in enumerate(names)
        }

    def answer(self, setup: bytes) -> bytes | None:
        """Answer a control request; None for a request that is not known, which stalls the endpoint."""
        kind, request, value, _, length = struct.unpack("<BBHHH", setup)
        if kind & INWARDS:
            if kind & RequestKind.MASK != RequestKind.STANDARD:
                return None
            answers = {Request.GET_STATUS: b"\1\0", Request.GET_DESCRIPTOR: self._descriptors.get(value)}
            data = answers.get(request)
            return None if data is None else data[:length]
        orders = {
            RequestKind.STANDARD: (Request.CLEAR_FEATURE, Request.SET_CONFIGURATION, Request.SET_INTERFACE),
            RequestKind.CLASS: (Request.HID_SET_IDLE,),
        }
        return b"" if request in orders.get(kind & RequestKind.MASK, ()) else None
