"""What the flash is: sectors of the part on the LightCrafter 4500, and where the controller sees it."""

from __future__ import annotations

import numpy as np

SECTOR = 0x20000
"""Bytes that are erased together."""

SECTORS = 256
SIZE = SECTORS * SECTOR

ADDRESS = 0xF9000000
"""Where the controller sees the first byte; tables in flash hold such addresses, the loader takes offsets."""

BOOT_SECTOR = 0
"""The loader itself: a projector without it cannot be mended over USB."""

ERASED = 0xFF


def flash_checksum(data: bytes) -> int:
    """The loader's checksum: the sum of the bytes, 32 bits of it."""
    return int(np.frombuffer(data, np.uint8).sum(dtype=np.uint64)) & 0xFFFFFFFF


def sector_of(offset: int) -> int:
    """The sector that holds the byte at `offset`."""
    return offset // SECTOR


def next_sector_start(offset: int) -> int:
    """The first sector boundary at or after `offset`."""
    return -(-offset // SECTOR) * SECTOR
