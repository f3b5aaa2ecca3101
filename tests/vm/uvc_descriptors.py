"""Descriptors of a USB camera of UVC 1.1 that streams raw monochrome frames through a bulk endpoint.

References
----------
USB Device Class Definition for Video Devices 1.1, chapters 3 and 4; its payload format for raw video.
"""

import struct

VENDOR, PRODUCT, NAME = 0x1209, 0x0001, "fpplab test camera"
WIDTH, HEIGHT = 48, 32
PERIOD_100_NS = 50_000
REFERENCE_EXPOSURE_S = 0.02
"""Exposure at which a share of 1 of the light fills the sensor."""
TERMINAL, PROCESSING = 1, 2
"""Units whose controls the camera has."""
EXPOSURE_MODE, EXPOSURE, GAIN, GAMMA = (TERMINAL, 2), (TERMINAL, 4), (PROCESSING, 4), (PROCESSING, 9)
"""Controls: unit and selector."""
FORMATS = {1: (b"Y800", 8), 2: (b"Y12 ", 12)}
"""By index: the beginning of its GUID, and the bit depth."""
HEADER_BYTES = 2
PAYLOAD_BYTES = HEADER_BYTES + 2 * WIDTH * HEIGHT
_GUID = bytes.fromhex("0000100080 0000aa00389b71")
_CLASS, _ENDPOINT = 0x24, 0x81


def _sized(*parts: bytes) -> bytes:
    body = b"".join(parts)
    return bytes([1 + len(body)]) + body


def _control_units() -> bytes:
    terminal = struct.pack("<BBBHBBHHHB3s", _CLASS, 2, TERMINAL, 0x0201, 0, 0, 0, 0, 0, 3, b"\x0a\0\0")
    processing = struct.pack("<BBBBHBHBB", _CLASS, 5, PROCESSING, TERMINAL, 0, 2, 0x0220, 0, 0)
    output = struct.pack("<BBBHBBB", _CLASS, 3, 3, 0x0101, 0, PROCESSING, 0)
    return _sized(terminal) + _sized(processing) + _sized(output)


def _control() -> bytes:
    units = _control_units()
    header = struct.pack("<BBHHIBB", _CLASS, 1, 0x0110, 13 + len(units), 48_000_000, 1, 1)
    return bytes([9, 4, 0, 0, 0, 0x0E, 1, 0, 0]) + _sized(header) + units


def _format(index: int, letters: bytes, bits: int) -> bytes:
    size = WIDTH * HEIGHT * (1 if bits == 8 else 2)
    rate = 8 * size * 200
    head = struct.pack(
        "<BBBB16sBBBBBB", _CLASS, 4, index, 1, letters + _GUID, 8 if bits == 8 else 16, 1, 0, 0, 0, 0
    )
    frame = struct.pack(
        *("<BBBBHHIIIIBI", _CLASS, 5, 1, 0, WIDTH, HEIGHT, rate, rate, size, PERIOD_100_NS, 1, PERIOD_100_NS)
    )
    return _sized(head) + _sized(frame)


def _streaming() -> bytes:
    formats = b"".join(_format(index, *kind) for index, kind in FORMATS.items())
    size = 13 + len(FORMATS) + len(formats)
    header = struct.pack("<BBBHBBBBBBB", _CLASS, 1, len(FORMATS), size, _ENDPOINT, 0, 3, 0, 0, 0, 1)
    endpoint = struct.pack("<BBBBHB", 7, 5, _ENDPOINT, 2, 512, 0)
    body = _sized(header, bytes(len(FORMATS))) + formats + endpoint
    return bytes([9, 4, 1, 0, 1, 0x0E, 2, 0, 0]) + body


def _configuration() -> bytes:
    body = bytes([8, 11, 0, 2, 0x0E, 3, 0, 0]) + _control() + _streaming()
    return struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), 2, 1, 0, 0x80, 50) + body


def _text(text: str) -> bytes:
    return _sized(b"\x03", text.encode("utf-16le"))


DESCRIPTORS = {
    0x0100: struct.pack(
        "<BBHBBBBHHHBBBB", 18, 1, 0x0200, 0xEF, 2, 1, 64, VENDOR, PRODUCT, 0x0100, 1, 2, 3, 1
    ),
    0x0200: _configuration(),
    0x0300: b"\x04\x03\x09\x04",
    0x0301: _text("fpplab"),
    0x0302: _text(NAME),
    0x0303: _text("U-1"),
}
"""By the value of the request."""


def probe(index: int) -> bytes:
    """What the camera negotiates for a format."""
    bits = FORMATS[index][1]
    size = WIDTH * HEIGHT * (1 if bits == 8 else 2)
    head = struct.pack("<HBBIHHHHHII", 0, index, 1, PERIOD_100_NS, 0, 0, 0, 0, 0, size, PAYLOAD_BYTES)
    return head + struct.pack("<IBBBB", 48_000_000, 0, 0, 0, 0)
