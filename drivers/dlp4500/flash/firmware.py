"""Firmware files of the LightCrafter 4500: their structure, and the replacement of the pattern images.

A file is an image of the flash from its first byte on: the boot loader, a table of blocks, the blocks, and
last the splash area with the images. New images begin at a sector boundary behind everything else, so that
replacing them affects no sector of the program; in the table only the address of the splash area changes, as
with TI's own tools.

Source: TI's DLPC350 client. Files were read by our decoder and TI's; not yet tested on a board.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.dlp4500.flash import memory
from drivers.dlp4500.flash.compression import CompressedImage, compress, repeats_every_four_lines
from drivers.dlp4500.packing import pack_images
from drivers.dlp4500.sequence import SIZE, Slot, pattern_numbers
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import read_bounded
from fpplab.patterns.fringes import Pattern

TABLE = 0x20000  # offset of the table of blocks, in bytes (TI's client)

TABLE_SECTOR = memory.sector_of(TABLE)  # sector of the table of blocks
_SIGNATURE = struct.pack("<I", 0x01234567)
_BLOCK = struct.Struct("<II")
_BLOCKS = TABLE + 16
_BLOCKS_END = _BLOCKS + 56 * _BLOCK.size  # entries of the table: from its offset 16 on, 56 of them
_SPLASH_BLOCKS = range(20, 24)
"""Table entries of the splash area; TI's firmware also lists single images there. New images replace all."""

SPLASH_ENTRY = _BLOCKS + _SPLASH_BLOCKS[0] * _BLOCK.size  # offset of the splash area's address in the table

_UNUSED = 0xFFFFFFFF  # address and size of a table entry that is not used, as erased flash reads

STORED = (2, 1, 0)  # order of the colour planes in a stored pixel: blue, red, green

MAX_IMAGES = 256  # entries of the splash area's table (TI's client)
_SPLASH_SIGNATURE = struct.pack("<II", 0x12345678, 0x87654321)
_IMAGES_AT = len(_SPLASH_SIGNATURE) + 4 + MAX_IMAGES * _BLOCK.size
"""Offset of the first image in the splash area."""

_HEADER = struct.Struct("<4sHHIIIIBBBB4x")
MAX_FILE_BYTES = 4 * memory.SIZE
"""Of a file that is read at all (chosen: several times what fits into the flash)."""


@dataclass(frozen=True)
class FlashBlock:
    """A contiguous range of the flash."""

    offset: int  # offset of its first byte
    size: int  # number of bytes

    @property
    def end(self) -> int:
        return self.offset + self.size


@dataclass(frozen=True)
class Firmware:
    """The contents of a firmware file."""

    content: bytes  # the flash from its first byte on
    source: Path  # the file, for errors

    @classmethod
    def load(cls, path: Path) -> Firmware:
        try:
            firmware = cls(read_bounded(path, MAX_FILE_BYTES), path)
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
        firmware._check()
        return firmware

    @property
    def splash(self) -> FlashBlock:
        """The splash area, up to the end of the file."""
        (address,) = struct.unpack_from("<I", self.content, SPLASH_ENTRY)
        offset = address - memory.ADDRESS
        return FlashBlock(offset, len(self.content) - offset)

    @property
    def blocks(self) -> tuple[FlashBlock, ...]:
        """Program and configuration: all blocks of the table except the splash area, by offset."""
        table = self.content[_BLOCKS:_BLOCKS_END]
        listed = [
            FlashBlock(address - memory.ADDRESS, size)
            for i, (address, size) in enumerate(_BLOCK.iter_unpack(table))
            if address != _UNUSED and i not in _SPLASH_BLOCKS
        ]
        return tuple(sorted(listed, key=lambda block: block.offset))

    @property
    def behind_program(self) -> int:
        """Offset of the first sector boundary behind every block."""
        return memory.next_sector_start(max(block.end for block in self.blocks))

    @property
    def images(self) -> int:
        start = self.splash.offset
        if not self.content.startswith(_SPLASH_SIGNATURE, start):
            raise DataError(f"{self.source}: has no images at {start:#x}, their address in its flash table")
        return int.from_bytes(self.content[start + 8 : start + 12], "little")

    def with_patterns(self, patterns: Sequence[Pattern], source: Path) -> Firmware:
        """Replace the images by patterns and keep the program."""
        _check(patterns)
        slots = arrange_patterns(patterns)
        if slots[-1].image >= MAX_IMAGES:
            raise ConfigError(
                f"{len(patterns)} patterns take {slots[-1].image + 1} images: the flash holds {MAX_IMAGES}"
            )
        start = self.behind_program
        splash = splash_area(
            [compress(np.ascontiguousarray(image[..., STORED])) for image in pack_images(patterns, slots)],
            memory.ADDRESS + start,
        )
        if start + len(splash) > memory.SIZE:
            raise ConfigError(
                f"{len(patterns)} patterns take {len(splash)} bytes of flash and {memory.SIZE - start} are "
                "free: use fewer, or patterns that compress well (fringes along one axis)"
            )
        content = bytearray(self.content[:start].ljust(start, b"\xff"))  # as erased
        struct.pack_into("<I", content, SPLASH_ENTRY, memory.ADDRESS + start)
        return Firmware(bytes(content) + splash, source)

    def _check(self) -> None:
        """Raise `DataError` unless this is a complete firmware whose program fits into the flash."""
        if len(self.content) < _BLOCKS_END or not self.content.startswith(_SIGNATURE, TABLE):
            raise DataError(
                f"{self.source}: is not a firmware of the LightCrafter 4500 (no flash table at {TABLE:#x})"
            )
        if len(self.content) > memory.SIZE:
            raise DataError(f"{self.source}: has {len(self.content)} bytes, the flash {memory.SIZE}")
        if not self.blocks:
            raise DataError(f"{self.source}: its flash table lists no program")
        for block in self.blocks:
            if block.offset < memory.SECTOR or block.end > len(self.content):
                raise DataError(
                    f"{self.source}: its flash table has a block at {block.offset:#x} … {block.end:#x}, "
                    f"outside {memory.SECTOR:#x} … {len(self.content):#x} of the file: it is truncated"
                )


def arrange_patterns(patterns: Sequence[Pattern]) -> list[Slot]:
    """Assign patterns to flash images in their order, as many of equal bit depth to an image as it holds."""
    # Patterns that repeat every four lines and others never share an image, as a single other pattern would
    # prevent the four-line compression of the image.
    slots: list[Slot] = []
    image, number, shared = -1, 0, None
    for pattern in patterns:
        bits = pattern.bit_depth
        kind = bits, repeats_every_four_lines(pattern.image)
        if kind != shared or number == len(pattern_numbers(bits)):
            image, number, shared = image + 1, 0, kind
        slots.append(Slot(image, number, bits))
        number += 1
    return slots


def _check(patterns: Sequence[Pattern]) -> None:
    if not patterns:
        raise ConfigError("no patterns were given")
    width, height = SIZE
    for pattern in patterns:
        if pattern.image.shape != (height, width):
            size = " x ".join(map(str, pattern.image.shape[::-1]))
            raise ConfigError(
                f"pattern {pattern.id} has {size} mirrors: the projector has {width} x {height}"
            )


def splash_area(images: Sequence[CompressedImage], address: int) -> bytes:
    """Encode the splash area: signature, number and table of the images, then each image with its header."""
    stored = [_header(image) + image.data for image in images]
    table = bytearray(_BLOCK.pack(_UNUSED, _UNUSED) * MAX_IMAGES)
    at = address + _IMAGES_AT
    for i, image in enumerate(stored):
        _BLOCK.pack_into(table, i * _BLOCK.size, at, len(image))
        at += len(image)
    return b"".join([_SPLASH_SIGNATURE, struct.pack("<I", len(images)), table, *stored])


def _header(image: CompressedImage) -> bytes:
    width, height = SIZE
    unused, background, packed_24_bit, byte_order, chroma_order = _UNUSED, 0, 1, 1, 0
    return _HEADER.pack(
        b"Splc", width, height, len(image.data), unused, unused, background,
        packed_24_bit, image.method, byte_order, chroma_order,
    )  # fmt: skip
