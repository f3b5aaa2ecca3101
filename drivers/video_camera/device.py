"""A device file of the kernel's video interface; an emulated bench substitutes its own object.

Methods raise `OSError` as the kernel does.
"""

import errno
import mmap
import os
import select
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.video_camera import structures as v4l2
from fpplab.core.system import posix, system_module

fcntl = system_module("fcntl")  # None where the kernel has no such interface: it is Linux's

BUFFERS = 4  # frames that the kernel may fill before one is taken (chosen: enough for a camera never to wait)


@dataclass(frozen=True)
class Control:
    """A control of the camera."""

    name: str  # as the kernel names it
    minimum: int
    maximum: int
    step: int
    default: int
    is_settable: bool  # false where it can be read only, or not set in the present mode


@dataclass(frozen=True, eq=False)
class StampedFrame:
    """One frame as the kernel delivers it."""

    pixels: NDArray[np.uint8]  # the bytes of all rows, a copy
    time_s: float | None  # by the computer's monotonic clock; None where the driver stamps frames otherwise
    is_damaged: bool  # whether the kernel reports that it may be incomplete


class VideoDevice:
    """An open device file."""

    def __init__(self, path: str) -> None:
        if fcntl is None:
            raise OSError(errno.ENOSYS, "V4L2 is not available on this system")
        self._file = os.open(path, os.O_RDWR | posix.O_NONBLOCK)
        self._memory: list[mmap.mmap] = []

    def close(self) -> None:
        """Close the file; the kernel stops the camera."""
        self._unmap()
        os.close(self._file)

    def identity(self) -> tuple[str, str, bool]:
        """Return the camera's name, where it is connected, and whether it captures frames into buffers."""
        capability = v4l2.Capability()
        fcntl.ioctl(self._file, v4l2.QUERY_CAPABILITY, capability)
        has_own = capability.capabilities & v4l2.HAS_OWN_CAPS
        caps = capability.device_caps if has_own else capability.capabilities
        needed = v4l2.IS_CAPTURE | v4l2.CAN_STREAM
        return capability.card.decode(), capability.bus.decode(), caps & needed == needed

    def formats(self) -> tuple[str, ...]:
        return tuple(self._formats())

    def format(self) -> tuple[str, int, int, int]:
        """Return the present pixel format, width and height in px, and bytes from row to row."""
        now = v4l2.PixelLayout(kind=v4l2.CAPTURE)
        fcntl.ioctl(self._file, v4l2.GET_FORMAT, now)
        letters = now.pixel_format.to_bytes(4, "little").decode("ascii")
        return letters, now.width, now.height, now.bytes_per_line

    def set_format(self, letters: str, width: int, height: int) -> None:
        """Set the format; the kernel takes the nearest one that the camera has."""
        layout = v4l2.PixelLayout(
            kind=v4l2.CAPTURE, width=width, height=height, pixel_format=v4l2.fourcc(letters), field=1
        )
        fcntl.ioctl(self._file, v4l2.SET_FORMAT, layout)

    def period_s(self) -> float | None:
        """Return the time in s from frame to frame; None where the driver does not report it."""
        now = v4l2.Period(kind=v4l2.CAPTURE)
        with suppress(OSError):
            fcntl.ioctl(self._file, v4l2.GET_PERIOD, now)
        return now.numerator / now.denominator if now.numerator and now.denominator else None

    def control(self, number: int) -> Control | None:
        description = v4l2.ControlDescription(id=number)
        try:
            fcntl.ioctl(self._file, v4l2.QUERY_CONTROL, description)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return None
            raise
        if description.flags & v4l2.DISABLED:
            return None
        settable = not description.flags & (v4l2.READ_ONLY | v4l2.INACTIVE)
        return Control(
            description.name.decode(),
            description.minimum,
            description.maximum,
            description.step,
            description.default,
            settable,
        )

    def get(self, number: int) -> int:
        control = v4l2.ControlValue(id=number)
        fcntl.ioctl(self._file, v4l2.GET_CONTROL, control)
        return int(control.value)

    def set(self, number: int, value: int) -> None:
        """Set a control; the kernel may take the nearest value."""
        fcntl.ioctl(self._file, v4l2.SET_CONTROL, v4l2.ControlValue(id=number, value=value))

    def start(self) -> None:
        request = v4l2.BufferRequest(count=BUFFERS, kind=v4l2.CAPTURE, memory=v4l2.MMAP)
        fcntl.ioctl(self._file, v4l2.REQUEST_BUFFERS, request)
        for index in range(request.count):
            buffer = v4l2.Buffer(index=index, kind=v4l2.CAPTURE, memory=v4l2.MMAP)
            fcntl.ioctl(self._file, v4l2.QUERY_BUFFER, buffer)
            offset = buffer.offset & 0xFFFF_FFFF
            self._memory.append(mmap.mmap(self._file, buffer.length, offset=offset))
            fcntl.ioctl(self._file, v4l2.QUEUE_BUFFER, buffer)
        self._stream(v4l2.STREAM_ON)

    def read(self, timeout_s: float) -> StampedFrame | None:
        ready, _, _ = select.select([self._file], [], [], max(timeout_s, 0.0))
        if not ready:
            return None
        buffer = v4l2.Buffer(kind=v4l2.CAPTURE, memory=v4l2.MMAP)
        fcntl.ioctl(self._file, v4l2.DEQUEUE_BUFFER, buffer)
        pixels = np.frombuffer(self._memory[buffer.index][: buffer.bytes_used], np.uint8)
        stamped = buffer.flags & v4l2.CLOCK == v4l2.MONOTONIC
        time_s = buffer.seconds + 1e-6 * buffer.microseconds if stamped else None
        damaged = bool(buffer.flags & v4l2.DAMAGED)
        fcntl.ioctl(self._file, v4l2.QUEUE_BUFFER, buffer)
        return StampedFrame(pixels, time_s, damaged)

    def stop(self) -> None:
        """Let no more frames come, and drop those that wait."""
        if self._memory:
            self._stream(v4l2.STREAM_OFF)
            self._unmap()
            none = v4l2.BufferRequest(count=0, kind=v4l2.CAPTURE, memory=v4l2.MMAP)
            fcntl.ioctl(self._file, v4l2.REQUEST_BUFFERS, none)

    def _stream(self, order: int) -> None:
        fcntl.ioctl(self._file, order, v4l2.CAPTURE.to_bytes(4, "little"))

    def _unmap(self) -> None:
        while self._memory:
            self._memory.pop().close()

    def _formats(self) -> Iterator[str]:
        for index in range(64):
            description: Any = v4l2.FormatDescription(index=index, kind=v4l2.CAPTURE)
            try:
                fcntl.ioctl(self._file, v4l2.ENUMERATE_FORMATS, description)
            except OSError as error:
                if error.errno == errno.EINVAL:
                    return
                raise
            yield description.pixel_format.to_bytes(4, "little").decode("ascii", "replace")
