"""Messages of the DLPC350 and the 64-byte USB reports that carry them, in both directions.

A message is a header (flags, sequence number, length as u16 little-endian) and a payload. The first report
holds the header and up to 60 bytes of payload, every further one 64 bytes of payload and no header. Bytes
after the payload in the last report are padding. A request's payload is the command, u16 little-endian, and
its data; the payload of a reply to a read is data alone: the command is not echoed. A reply to a write may
carry the command, as clients written for the board expect it; nothing depends on it.

Source: TI's DLPC350 client (API 4.0) and its recorded packets. Not yet tested on a board.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

REPORT_BYTES = 64  # size of every USB report (TI's client; the greatest at full speed, USB 2.0, 5.7.3)
HEADER_BYTES = 4  # size of a message's header: flags, sequence number, length
FIRST_BYTES = REPORT_BYTES - HEADER_BYTES  # payload bytes in the first report of a message
MAX_PAYLOAD_BYTES = 512 - HEADER_BYTES  # longest payload: the client's message buffer holds 512 bytes

READ, REPLY_WANTED, ERROR = 0x80, 0x40, 0x20
"""Flags of a header. The error bit is set by the device only."""
DESTINATION = 0x07
"""Mask of the flags that select the addressee; 0, the projector's control, is the only one used."""


class Header(NamedTuple):
    """The first four bytes of a message."""

    flags: int  # combination of `READ`, `REPLY_WANTED` and `ERROR`
    sequence: int  # sequence number, 0 to 255
    length: int  # bytes of payload


@dataclass(frozen=True)
class UsbMessage:
    """One request or one reply."""

    flags: int  # combination of `READ`, `REPLY_WANTED` and `ERROR`
    sequence: int  # sequence number, 0 to 255
    payload: bytes = b""  # up to 508 bytes: command and data of a request, data of a reply

    @property
    def failed(self) -> bool:
        return bool(self.flags & ERROR)

    def reports(self) -> list[bytes]:
        if len(self.payload) > MAX_PAYLOAD_BYTES:
            raise ValueError(f"a payload of {len(self.payload)} bytes: at most {MAX_PAYLOAD_BYTES}")
        message = struct.pack("<BBH", self.flags, self.sequence, len(self.payload)) + self.payload
        return [
            message[start : start + REPORT_BYTES].ljust(REPORT_BYTES, b"\0")
            for start in range(0, len(message), REPORT_BYTES)
        ]


def make_request(command: int, data: bytes, sequence: int, flags: int) -> UsbMessage:
    """Build a request; TI's documents give the two bytes of a command in the opposite order."""
    return UsbMessage(flags, sequence, struct.pack("<H", command) + data)


def parse_header(report: bytes) -> Header:
    if len(report) != REPORT_BYTES:
        raise ValueError(f"a report of {len(report)} bytes: {REPORT_BYTES}")
    header = Header(*struct.unpack_from("<BBH", report))
    if header.length > MAX_PAYLOAD_BYTES:
        raise ValueError(f"a payload of {header.length} bytes: at most {MAX_PAYLOAD_BYTES}")
    return header


def continuation_reports(length: int) -> int:
    return max(0, -(-(length - FIRST_BYTES) // REPORT_BYTES))


def join_reports(reports: Sequence[bytes]) -> UsbMessage:
    flags, sequence, length = parse_header(reports[0])
    if len(reports) != 1 + continuation_reports(length) or any(len(r) != REPORT_BYTES for r in reports):
        raise ValueError(f"{len(reports)} reports for a payload of {length} bytes")
    return UsbMessage(flags, sequence, b"".join(reports)[HEADER_BYTES : HEADER_BYTES + length])
