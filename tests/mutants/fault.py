"""A fault that can be seeded into a source."""

from typing import Protocol


class Fault(Protocol):
    """`name` identifies it while other code changes; `line` is one that the tests that judge it execute."""

    @property
    def name(self) -> str: ...
    @property
    def file(self) -> str: ...
    @property
    def line(self) -> int: ...

    def seeded(self, source: bytes) -> bytes:
        """The source with the fault in it."""
        ...
