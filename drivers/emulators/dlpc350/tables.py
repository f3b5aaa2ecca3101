"""The tables behind the mailboxes: patterns, patterns with times of their own, images."""

from __future__ import annotations

from typing import TypeVar

from drivers.dlp4500.protocol import ENTRY, MOST_ENTRIES, Values

Content = TypeVar("Content")
RegisterContents = dict[int, Content]

POWER_ON_PATTERNS = bytes.fromhex("001806 042802 084802")
POWER_ON_IMAGES = bytes([1])


class PatternTables:
    """What was written, by place. Each writing raises `ValueError` for what does not fit."""

    def __init__(self) -> None:
        self.patterns: RegisterContents[Values] = {}
        self.variable: RegisterContents[Values] = {}
        self.images: RegisterContents[int] = {}
        self.fill_patterns(0, POWER_ON_PATTERNS)
        self.fill_images(0, POWER_ON_IMAGES, len(POWER_ON_IMAGES))

    def fill_patterns(self, address: int, data: bytes) -> None:
        """Entries of 3 bytes from an address on."""
        if len(data) % 3 or address + len(data) // 3 > MOST_ENTRIES:
            raise ValueError("entries that do not fit")
        entries = [ENTRY.unpack(data[i : i + 3]) for i in range(0, len(data), 3)]
        _continue(self.patterns, address, entries)

    def fill_images(self, address: int, data: bytes, most: int) -> None:
        """Images from an address on, in a table of `most`."""
        if address + len(data) > most:
            raise ValueError("images that do not fit")
        _continue(self.images, address, list(data))

    def fill_variable(self, address: int, values: Values) -> None:
        """One entry with its times."""
        _continue(self.variable, address, [values])

    def entries(self, variable: bool, count: int) -> list[Values]:
        """The first `count` that were written."""
        table = self.variable if variable else self.patterns
        return [table[i] for i in range(count) if i in table]

    def images_shown(self, count: int) -> list[int]:
        """In the order in which they are swapped in: a table of two is read from its end."""
        images = [self.images[i] for i in range(count) if i in self.images]
        return images[::-1] if len(images) == 2 else images

    def pattern_bytes(self, count: int) -> bytes:
        """What is read back of the pattern table; zero where nothing was written."""
        zero = ENTRY.unpack(bytes(3))
        return b"".join(ENTRY.pack(self.patterns.get(i, zero)) for i in range(min(count, MOST_ENTRIES)))

    def image_bytes(self, count: int) -> bytes:
        """What is read back of the image table."""
        return bytes(self.images.get(i, 0) for i in range(count))


def _continue(table: RegisterContents[Content], address: int, content: list[Content]) -> None:
    """Write from an address on; the table ends there until more is written."""
    for beyond in [i for i in table if i >= address]:
        del table[beyond]
    table |= {address + i: entry for i, entry in enumerate(content)}
