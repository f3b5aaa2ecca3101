"""The flash memory of the emulated projector, and a reader of the images that are stored there.

The reader shares no code with the builder of flash images in the driver, so that each verifies the other.

Source: Layout as TI's client reads it.
"""

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SIZE, SECTOR = 0x2000000, 0x20000  # bytes of the flash, and of what is erased together
BASE_ADDRESS = 0xF9000000  # address of the first byte in the controller's memory (TI's client)
TABLE = 0x20000  # offset of the table of blocks, in bytes (TI's client)
SPLASH_ADDRESS = TABLE + 176  # offset of the address of the splash area, in the table
NONE = 0xFFFFFFFF  # entry of a table that is not used, as erased flash reads
_HEADER = struct.Struct("<4sHHIIIIBBBB4x")


class Flash:
    """Flash memory: writing can only clear bits, until their sector is erased to ones."""

    def __init__(self, content: bytes) -> None:
        self.content = bytearray(content.ljust(SIZE, b"\xff"))

    def erase(self, sector: int) -> None:
        self.content[sector * SECTOR : (sector + 1) * SECTOR] = b"\xff" * SECTOR

    def erase_partially(self, sector: int) -> None:
        """Leave a sector as after a power failure during erasing: neither the old content nor ones."""
        part = slice(sector * SECTOR, (sector + 1) * SECTOR)
        self.content[part] = np.random.default_rng(sector).bytes(SECTOR)

    def write(self, offset: int, data: bytes) -> None:
        """Clear the bits that are zero in `data`."""
        part = slice(offset, offset + len(data))
        old = np.frombuffer(bytes(self.content[part]), np.uint8)
        self.content[part] = (old & np.frombuffer(data, np.uint8)).tobytes()

    def checksum(self, offset: int, size: int) -> int:
        part = np.frombuffer(bytes(self.content[offset : offset + size]), np.uint8)
        return int(part.sum(dtype=np.uint64)) & 0xFFFFFFFF

    def read_listed_firmware_blocks(self) -> list[bytes] | None:
        if self.content[TABLE : TABLE + 4] != bytes.fromhex("67452301"):
            return None
        listed = [struct.unpack_from("<II", self.content, TABLE + 16 + 8 * i) for i in range(56)]
        blocks = [entry for i, entry in enumerate(listed) if not 20 <= i < 24 and entry[0] != NONE]
        return [bytes(self.content[at - BASE_ADDRESS : at - BASE_ADDRESS + size]) for at, size in blocks]


@dataclass(frozen=True, eq=False)
class StoredImage:
    """An image in flash."""

    compression: int  # method of compression as in the image's header
    stored: int  # size of the compressed pixels in bytes, without header
    planes: NDArray[np.uint8]  # uint8 (height, width, 3), green, red, blue


def stored_images(flash: bytes | bytearray) -> list[StoredImage]:
    (splash,) = struct.unpack_from("<I", flash, SPLASH_ADDRESS)
    start = splash - BASE_ADDRESS
    if flash[start : start + 8] != bytes.fromhex("7856341221436587"):
        raise ValueError(f"there are no images at {start:#x}")
    (count,) = struct.unpack_from("<I", flash, start + 8)
    table = [struct.unpack_from("<II", flash, start + 12 + 8 * i) for i in range(256)]
    if any(entry != (NONE, NONE) for entry in table[count:]):
        raise ValueError(f"the table of {count} images has entries beyond its end")
    images, end = [], start + 2060
    for address, size in table[:count]:
        if address - BASE_ADDRESS != end:
            raise ValueError(f"an image begins at {address:#x}, but the one before it ends at {end:#x}")
        end += size
        images.append(_parse_image(bytes(flash[end - size : end])))
    return images


def _parse_image(blob: bytes) -> StoredImage:
    magic, width, height, stored, *constant, pixel_format, compression, order, chroma = _HEADER.unpack_from(
        blob
    )
    if (magic, *constant, pixel_format, order, chroma) != (b"Splc", NONE, NONE, 0, 1, 1, 0):
        raise ValueError(f"an image has the unknown header {blob[: _HEADER.size].hex()}")
    if len(blob) != _HEADER.size + stored:
        raise ValueError(f"an image has {len(blob)} bytes, but its header says {stored} without the header")
    pixels = decompress_pixels(compression, blob[_HEADER.size :], width, height)
    return StoredImage(compression, stored, pixels[..., ::-1])


def decompress_pixels(compression: int, data: bytes, width: int, height: int) -> NDArray[np.uint8]:
    # returns (height, width, 3)
    if compression == 1:
        flat = _from_runs(data, width, height)
    elif compression == 4:
        flat = (data * -(-height // 4))[: width * height * 3]
    elif compression == 0:
        flat = data
    else:
        raise ValueError(f"unknown compression {compression}")
    return np.frombuffer(flat, np.uint8).reshape(height, width, 3)


def _from_runs(data: bytes, width: int, height: int) -> bytes:
    rows: list[bytes] = []
    row, at = b"", 0
    while True:
        control, at = data[at], at + 1
        if control:
            row += data[at : at + 3] * control
            at += 3
            continue
        literal, at = data[at], at + 1
        if literal >= 2:
            row += data[at : at + 3 * literal]
            at += 3 * literal
        elif literal == 0:
            if len(row) != 3 * width:
                raise ValueError(f"row {len(rows)} has {len(row)} bytes for {width} pixels")
            rows.append(row)
            row, at = b"", _skip_padding(data, at, 4)
        else:
            if row or len(rows) != height or _skip_padding(data, at, 16) != len(data):
                raise ValueError(f"the image ends after {len(rows)} of {height} rows, at {at} of {len(data)}")
            return b"".join(rows)


def _skip_padding(data: bytes, offset: int, multiple: int) -> int:
    end = offset + -offset % multiple
    if any(data[offset:end]):
        raise ValueError(f"the padding at byte {offset} is not zero")
    return end
