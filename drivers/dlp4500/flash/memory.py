"""Layout of the LightCrafter 4500's flash: its sectors, and its address in the controller's memory."""

from __future__ import annotations

import numpy as np

SECTOR = 0x20000
"""Bytes that are erased together."""

SECTORS = 256
"""Number of sectors."""
SIZE = SECTORS * SECTOR
"""Bytes of the whole flash."""

ADDRESS = 0xF9000000
"""Address of the first byte; tables in flash hold such addresses, the boot loader takes offsets."""

BOOT_SECTOR = 0
"""Sector of the boot loader: without it a projector cannot be repaired over USB."""

ERASED = 0xFF
"""Value of an erased byte."""


def flash_checksum(data: bytes) -> int:
    """Compute the boot loader's checksum.

    Parameters
    ----------
    data : bytes
        The bytes.

    Returns
    -------
    int
        Sum of the bytes, modulo 2^32.
    """
    return int(np.frombuffer(data, np.uint8).sum(dtype=np.uint64)) & 0xFFFFFFFF


def sector_of(offset: int) -> int:
    """Find the sector of a byte.

    Parameters
    ----------
    offset : int
        Offset of the byte from the first one of the flash.

    Returns
    -------
    int
        Number of the sector.
    """
    return offset // SECTOR


def next_sector_start(offset: int) -> int:
    """Round an offset up to a sector boundary.

    Parameters
    ----------
    offset : int
        Offset from the first byte of the flash.

    Returns
    -------
    int
        The first sector boundary at or after it.
    """
    return -(-offset // SECTOR) * SECTOR
