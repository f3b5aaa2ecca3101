"""The tables behind the controller's mailboxes: patterns, patterns with variable exposure, and images."""

from __future__ import annotations

from typing import Self, TypeVar

from drivers.dlp4500.layout import Values
from drivers.dlp4500.protocol import ENTRY, MAX_ENTRIES

Content = TypeVar("Content")
RegisterContents = dict[int, Content]  # table entries by their address

POWER_ON_PATTERNS = bytes.fromhex("001806 042802 084802")
"""Pattern table after power-on: three entries of 3 bytes."""
POWER_ON_IMAGES = bytes([1])  # image table after power-on: flash image 1


class PatternTables:
    """The tables as written; writing entries from an address on discards older ones from there on."""

    def __init__(self) -> None:
        self.patterns: RegisterContents[Values] = {}
        self.variable: RegisterContents[Values] = {}
        self.images: RegisterContents[int] = {}

    @classmethod
    def at_power_on(cls) -> Self:
        tables = cls()
        tables.fill_patterns(0, POWER_ON_PATTERNS)
        tables.fill_images(0, POWER_ON_IMAGES, len(POWER_ON_IMAGES))
        return tables

    def fill_patterns(self, address: int, data: bytes) -> None:
        if len(data) % 3 or address + len(data) // 3 > MAX_ENTRIES:
            raise ValueError("the entries do not fit in the pattern table")
        entries = [ENTRY.unpack(data[i : i + 3]) for i in range(0, len(data), 3)]
        _write_entries(self.patterns, address, entries)

    def fill_images(self, address: int, data: bytes, size: int) -> None:
        if address + len(data) > size:
            raise ValueError("the images do not fit in the image table")
        _write_entries(self.images, address, list(data))

    def fill_variable(self, address: int, values: Values) -> None:
        _write_entries(self.variable, address, [values])

    def entries(self, variable: bool, count: int) -> list[Values]:
        """Return the entries of a pattern table, without addresses that were not written."""
        table = self.variable if variable else self.patterns
        return [table[i] for i in range(count) if i in table]

    def images_shown(self, count: int) -> list[int]:
        """Return the image indices in the order in which the sequencer swaps them in."""
        images = [self.images[i] for i in range(count) if i in self.images]
        return images[::-1] if len(images) == 2 else images

    def pattern_bytes(self, count: int) -> bytes:
        zero = ENTRY.unpack(bytes(3))
        return b"".join(ENTRY.pack(self.patterns.get(i, zero)) for i in range(min(count, MAX_ENTRIES)))

    def image_bytes(self, count: int) -> bytes:
        return bytes(self.images.get(i, 0) for i in range(count))


def _write_entries(table: RegisterContents[Content], address: int, content: list[Content]) -> None:
    """Write entries from an address on; the table ends behind them until more is written."""
    for beyond in [i for i in table if i >= address]:
        del table[beyond]
    table |= {address + i: entry for i, entry in enumerate(content)}
