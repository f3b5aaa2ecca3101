"""A firmware file in the maker's layout."""

import struct

import numpy as np

BASE = 0xF9000000
TABLE = 0x20000
NOTHING = (0xFFFFFFFF, 0xFFFFFFFF)

PROGRAM = {
    0: (0xF9030000, 408152),
    4: (0xF909B180, 175760),
    5: (0xF902A000, 3824),
    6: (0xF90E0A40, 517512),
    8: (0xF90C6020, 104904),
    9: (0xF90DF9F0, 52),
    12: (0xF9093C00, 30064),
    40: (0xF90DFA40, 1024),
    41: (0xF90DFE40, 1024),
    42: (0xF90E0240, 1024),
    43: (0xF90E0640, 1024),
}
"""Program and configuration in release 4.4 of the maker's firmware, by index in the flash table."""

IMAGES = {20: (0xF915EFD0, 37520), 21: (0xF9168260, 39504), 22: (0xF9171CB0, 43216)}
"""Address of the images that it comes with."""

END = 0x17C580
BEHIND_PROGRAM = 0x160000
"""The first sector boundary behind the program."""


def maker_firmware(blocks: dict[int, tuple[int, int]] | None = None, end: int = END) -> bytes:
    """Make a file with a flash table of these blocks (address, size), and noise everywhere else."""
    content = bytearray(np.random.default_rng(1).bytes(end))
    listed = [(PROGRAM | IMAGES if blocks is None else blocks).get(i, NOTHING) for i in range(56)]
    table = struct.pack("<IIII", 0x01234567, BASE, 0x13, end)
    table += b"".join(struct.pack("<II", *block) for block in listed)
    content[TABLE : TABLE + len(table)] = table
    return bytes(content)
