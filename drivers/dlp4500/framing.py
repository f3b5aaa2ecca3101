"""Messages of the DLPC350 and the 64-byte USB reports that carry them, in either direction.

A message is a header (flags, sequence, length u16 little-endian) and a payload. The first report holds the
header and up to 60 bytes of payload, every further one 64 bytes of payload and no header. What follows the
payload in the last report is padding. A request's payload is the command, u16 little-endian, and its data; a
reply's payload is data alone: the command is not echoed.

Source: TI's DLPC350 client (API 4.0) and its recorded packets. Nothing here has been near a board.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

REPORT_BYTES = 64
HEADER_BYTES = 4
FIRST_BYTES = REPORT_BYTES - HEADER_BYTES
MOST_PAYLOAD = 512 - HEADER_BYTES
"""The client's message buffer holds 512 bytes."""

READ, REPLY_WANTED, ERROR = 0x80, 0x40, 0x20
"""Flags. The error bit comes from the device alone."""
DESTINATION = 0x07
"""Bits of the flags that say whom the message is for; 0, the projector's control, is the only one used."""


class Header(NamedTuple):
    """The first four bytes of a message; `length` counts the payload."""

    flags: int
    sequence: int
    length: int


@dataclass(frozen=True)
class UsbMessage:
    """One request or one reply."""

    flags: int
    sequence: int
    payload: bytes = b""

    @property
    def failed(self) -> bool:
        """Whether the device says that it did not do what was asked."""
        return bool(self.flags & ERROR)

    def reports(self) -> list[bytes]:
        """The reports that carry it, each 64 bytes, padded with zeros.

        Raises `ValueError` for a payload beyond 508 bytes.
        """
        if len(self.payload) > MOST_PAYLOAD:
            raise ValueError(f"a payload of {len(self.payload)} bytes: at most {MOST_PAYLOAD}")
        whole = struct.pack("<BBH", self.flags, self.sequence, len(self.payload)) + self.payload
        return [
            whole[start : start + REPORT_BYTES].ljust(REPORT_BYTES, b"\0")
            for start in range(0, len(whole), REPORT_BYTES)
        ]


def make_request(command: int, data: bytes, sequence: int, flags: int) -> UsbMessage:
    """A request: `command` and its data."""
    return UsbMessage(flags, sequence, struct.pack("<H", command) + data)


def parse_header(report: bytes) -> Header:
    """The header in a message's first report.

    Raises `ValueError` for a report that is not 64 bytes, and for a length that no message has.
    """
    if len(report) != REPORT_BYTES:
        raise ValueError(f"a report of {len(report)} bytes: {REPORT_BYTES}")
    found = Header(*struct.unpack_from("<BBH", report))
    if found.length > MOST_PAYLOAD:
        raise ValueError(f"a payload of {found.length} bytes: at most {MOST_PAYLOAD}")
    return found


def continuation_reports(length: int) -> int:
    """How many reports follow the first one of a message whose payload has `length` bytes."""
    return max(0, -(-(length - FIRST_BYTES) // REPORT_BYTES))


def join_reports(reports: Sequence[bytes]) -> UsbMessage:
    """The message that `reports`, all of it and no more, carry.

    Raises `ValueError` when their number or size is not what the header says.
    """
    flags, sequence, length = parse_header(reports[0])
    if len(reports) != 1 + continuation_reports(length) or any(len(r) != REPORT_BYTES for r in reports):
        raise ValueError(f"{len(reports)} reports for a payload of {length} bytes")
    return UsbMessage(flags, sequence, b"".join(reports)[HEADER_BYTES : HEADER_BYTES + length])
