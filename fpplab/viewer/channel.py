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
    """What the process that draws is told first.

    Attributes
    ----------
    view : type
        Subclass of `CommandView`.
    shown : str or None
        Where it is shown; None, and it is recorded alone.
    keep : Path or None
        Recording (.rrd) that is left when the view is closed.
    """

    view: type
    shown: Shown | None
    keep: Path | None


def write_message(stream: BinaryIO, message: object) -> None:
    """Write one object.

    Parameters
    ----------
    stream : BinaryIO
        Unbuffered.
    message : object
        What `pickle` can take.

    Raises
    ------
    OSError
        Nobody reads any more.
    """
    buffers: list[pickle.PickleBuffer] = []
    packed = pickle.dumps(message, protocol=5, buffer_callback=buffers.append)
    parts: list[bytes | memoryview] = [packed, *(buffer.raw() for buffer in buffers)]
    head = _HEAD.pack(len(parts)) + b"".join(_SIZE.pack(len(part)) for part in parts)
    for part in (head, *parts):
        rest = memoryview(part)
        while len(rest):
            rest = rest[stream.write(rest) :]


def read_message(stream: BinaryIO) -> Any:
    """Read one object that `write_message` of this program's own parent wrote.

    Parameters
    ----------
    stream : BinaryIO
        Buffered.

    Returns
    -------
    object
        What was written.

    Raises
    ------
    EOFError
        There is nothing more.
    """
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
