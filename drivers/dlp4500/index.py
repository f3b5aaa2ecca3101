"""Which pattern is where in the projector's flash.

    patterns:
      - {id: x1-00, image: 0, number: 0, bits: 8, sha256: 6f0c...}

A pattern is known by what it shows, not by its name alone: the checksum is of its grey levels as the
projector shows them. So a plan whose patterns are not the ones in flash is refused, never shown wrong.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.dlp4500.protocol import MOST_VARIABLE_IMAGES
from drivers.dlp4500.sequence import Slot
from fpplab.core.config import Document
from fpplab.patterns.fringes import Pattern, quantise


def shown_image(pattern: Pattern) -> NDArray[np.uint8]:
    """The grey levels that mirrors make of a pattern at its depth, uint8 (height, width), scale 0 … 255."""
    levels = quantise(np.arange(256) / 255.0, pattern.bit_depth)
    return np.asarray(levels[pattern.image], np.uint8)


def index_checksum(image: NDArray[np.uint8]) -> str:
    """SHA-256 of grey levels, row by row."""
    return hashlib.sha256(image.tobytes()).hexdigest()


class FlashPattern(Document):
    """One pattern in flash: image and number say where, sha256 what (see `index_checksum`)."""

    id: str
    image: Annotated[int, Field(ge=0, lt=MOST_VARIABLE_IMAGES)]
    number: Annotated[int, Field(ge=0, le=23)]
    bits: Annotated[int, Field(ge=1, le=8)] = 8
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]

    @property
    def slot(self) -> Slot:
        """Where it is."""
        return Slot(self.image, self.number, self.bits)

    @classmethod
    def of(cls, pattern: Pattern, image: int, number: int) -> FlashPattern:
        """The entry of a pattern that is put there."""
        return cls(
            id=pattern.id,
            image=image,
            number=number,
            bits=pattern.bit_depth,
            sha256=index_checksum(shown_image(pattern)),
        )


class FlashIndex(Document):
    """Everything that is in flash."""

    patterns: Annotated[tuple[FlashPattern, ...], Field(min_length=1)]

    @classmethod
    def of(cls, patterns: Sequence[Pattern], slots: Sequence[Slot]) -> FlashIndex:
        """The index of patterns that are put into these places."""
        places = zip(patterns, slots, strict=True)
        return cls(patterns=tuple(FlashPattern.of(p, at.image, at.number) for p, at in places))

    @property
    def depths(self) -> set[int]:
        """The bit depths that there are."""
        return {pattern.bits for pattern in self.patterns}

    def find(self, name: str, bits: int, sha256: str) -> FlashPattern | None:
        """The pattern that shows this, the one of that name among equals; None where there is none."""
        alike = [p for p in self.patterns if (p.bits, p.sha256) == (bits, sha256)]
        return next((p for p in alike if p.id == name), alike[0] if alike else None)
