"""Structures, numbers and requests of the kernel's video interface, on 64-bit Linux.

Source: Linux, Documentation/userspace-api/media/v4l and include/uapi/linux/videodev2.h.
"""

import ctypes
from ctypes import Structure, c_char, c_int32, c_int64, c_uint8, c_uint32, c_uint64

CAPTURE, MMAP = 1, 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE and V4L2_MEMORY_MMAP: kind of buffer, and of its memory
IS_CAPTURE, CAN_STREAM, HAS_OWN_CAPS = 0x1, 0x0400_0000, 0x8000_0000
"""V4L2_CAP_…: bits of a device's capabilities."""
DISABLED, READ_ONLY, INACTIVE = 0x1, 0x4, 0x10  # V4L2_CTRL_FLAG_…: bits of a control's flags
DAMAGED, CLOCK, MONOTONIC = 0x40, 0xE000, 0x2000
"""V4L2_BUF_FLAG_…: damaged, the mask for the clock of its time, and the monotonic clock's value there."""


class Capability(Structure):
    """What a device is."""

    _fields_ = (
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus", c_char * 32),
        ("version", c_uint32),
        ("capabilities", c_uint32),
        ("device_caps", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class FormatDescription(Structure):
    """One pixel format that a device has."""

    _fields_ = (
        ("index", c_uint32),
        ("kind", c_uint32),
        ("flags", c_uint32),
        ("description", c_char * 32),
        ("pixel_format", c_uint32),
        ("mbus_code", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class PixelLayout(Structure):
    """The format of frames; of the union only the part for single planes."""

    _fields_ = (
        ("kind", c_uint32),
        ("_", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("pixel_format", c_uint32),
        ("field", c_uint32),
        ("bytes_per_line", c_uint32),
        ("image_bytes", c_uint32),
        ("rest", c_uint8 * 176),
    )


class Period(Structure):
    """Time per frame; of the union only the part for capture."""

    _fields_ = (
        ("kind", c_uint32),
        ("capability", c_uint32),
        ("mode", c_uint32),
        ("numerator", c_uint32),
        ("denominator", c_uint32),
        ("rest", c_uint8 * 184),
    )


class BufferRequest(Structure):
    """How many buffers are requested."""

    _fields_ = (
        ("count", c_uint32),
        ("kind", c_uint32),
        ("memory", c_uint32),
        ("capabilities", c_uint32),
        ("flags", c_uint32),
    )


class Buffer(Structure):
    """One buffer."""

    _fields_ = (
        ("index", c_uint32),
        ("kind", c_uint32),
        ("bytes_used", c_uint32),
        ("flags", c_uint32),
        ("field", c_uint32),
        ("seconds", c_int64),
        ("microseconds", c_int64),
        ("time_code", c_uint8 * 16),
        ("sequence", c_uint32),
        ("memory", c_uint32),
        ("offset", c_uint64),
        ("length", c_uint32),
        ("reserved", c_uint32 * 2),
    )


class ControlDescription(Structure):
    """One control that a device has."""

    _fields_ = (
        ("id", c_uint32),
        ("kind", c_uint32),
        ("name", c_char * 32),
        ("minimum", c_int32),
        ("maximum", c_int32),
        ("step", c_int32),
        ("default", c_int32),
        ("flags", c_uint32),
        ("reserved", c_uint32 * 2),
    )


class ControlValue(Structure):
    """Value of one control."""

    _fields_ = (("id", c_uint32), ("value", c_int32))


def _request(direction: int, number: int, kind: type) -> int:
    return direction << 30 | ctypes.sizeof(kind) << 16 | ord("V") << 8 | number


_WRITE, _READ, _BOTH = 1, 2, 3
QUERY_CAPABILITY = _request(_READ, 0, Capability)
ENUMERATE_FORMATS = _request(_BOTH, 2, FormatDescription)
GET_FORMAT, SET_FORMAT = _request(_BOTH, 4, PixelLayout), _request(_BOTH, 5, PixelLayout)
REQUEST_BUFFERS = _request(_BOTH, 8, BufferRequest)
QUERY_BUFFER, QUEUE_BUFFER, DEQUEUE_BUFFER = (_request(_BOTH, number, Buffer) for number in (9, 15, 17))
STREAM_ON, STREAM_OFF = _request(_WRITE, 18, c_int32), _request(_WRITE, 19, c_int32)
GET_PERIOD = _request(_BOTH, 21, Period)
GET_CONTROL, SET_CONTROL = _request(_BOTH, 27, ControlValue), _request(_BOTH, 28, ControlValue)
QUERY_CONTROL = _request(_BOTH, 36, ControlDescription)


def fourcc(name: str) -> int:
    """Return the number of a pixel format."""
    return int.from_bytes(name.encode("ascii"), "little")
