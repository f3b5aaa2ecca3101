"""Layout of the LightCrafter 4500's flash: its sectors, and its address in the controller's memory."""

import numpy as np

SECTOR = 0x20000  # bytes that are erased together, as TI's GUI knows the evaluation module's flash
SIZE = 256 * SECTOR  # bytes of the whole flash

ADDRESS = 0xF9000000
"""Address of the first byte (TI's client); tables in flash hold such, the boot loader takes offsets."""


def flash_checksum(data: bytes) -> int:
    return int(np.frombuffer(data, np.uint8).sum(dtype=np.uint64)) & 0xFFFFFFFF


def sector_of(offset: int) -> int:
    return offset // SECTOR


def next_sector_start(offset: int) -> int:
    return -(-offset // SECTOR) * SECTOR
