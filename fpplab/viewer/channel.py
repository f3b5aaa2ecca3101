"""Objects through a pipe to a process of one's own: arrays go as they are, without a copy in the pickle."""

from __future__ import annotations

import pickle
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from fpplab.viewer.server import Shown

WAITING = "waiting"
"""Message, instead of a method: answer now, and again when the operator has closed the view."""

_HEAD = struct.Struct("<I")
_SIZE = struct.Struct("<Q")


@dataclass(frozen=True)
class Opening:
    """What the process that draws is told first."""

    view: type  # subclass of `CommandView`
    shown: Shown | None  # where it is shown; None, and it is recorded alone
    keep: Path | None  # recording (.rrd) that is left when the view is closed


def write_message(stream: BinaryIO, message: object) -> None:
    """Write one object."""
    buffers: list[pickle.PickleBuffer] = []
    packed = pickle.dumps(message, protocol=5, buffer_callback=buffers.append)
    parts: list[bytes | memoryview] = [packed, *(buffer.raw() for buffer in buffers)]
    head = _HEAD.pack(len(parts)) + b"".join(_SIZE.pack(len(part)) for part in parts)
    for part in (head, *parts):
        rest = memoryview(part)
        while len(rest):
            rest = rest[stream.write(rest) :]


def read_message(stream: BinaryIO) -> Any:
    """Read one object that `write_message` of this program's own parent wrote."""
    (count,) = _HEAD.unpack(_exactly(stream, _HEAD.size))
    sizes = [_SIZE.unpack(_exactly(stream, _SIZE.size))[0] for _ in range(count)]
    packed, *buffers = [_exactly(stream, size) for size in sizes]
    return pickle.loads(packed, buffers=buffers)


def _exactly(stream: BinaryIO, size: int) -> bytearray:
    found = bytearray(size)
    view = memoryview(found)
    while len(view):
        count = stream.readinto(view)  # type: ignore[attr-defined]
        if not count:
            raise EOFError
        view = view[count:]
    return found
