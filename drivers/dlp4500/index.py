"""Index of the patterns in the projector's flash.

    patterns:
      - {id: x1-00, image: 0, number: 0, bits: 8, sha256: 6f0c...}

A pattern is identified by its contents, not by its name alone: the checksum is that of its grey levels as
the projector shows them. A plan whose patterns are not those in flash is therefore refused.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.dlp4500.protocol import MAX_VARIABLE_IMAGES
from drivers.dlp4500.sequence import Slot
from fpplab.core.config import Document
from fpplab.patterns.fringes import Pattern, quantise


def shown_image(pattern: Pattern) -> NDArray[np.uint8]:
    """Compute the grey levels that the mirrors show of a pattern at its bit depth."""
    # returns (height, width)
    levels = quantise(np.arange(256) / 255.0, pattern.bit_depth)
    return np.asarray(cv2.LUT(np.ascontiguousarray(pattern.image), levels), np.uint8)


def index_checksum(image: NDArray[np.uint8]) -> str:
    # image (height, width)
    return hashlib.sha256(image.tobytes()).hexdigest()


class FlashPattern(Document):
    """One pattern in flash: its location and its checksum."""

    id: str
    """Name of the pattern in its plan."""
    image: Annotated[int, Field(ge=0, lt=MAX_VARIABLE_IMAGES)]
    """Index of the flash image."""
    number: Annotated[int, Field(ge=0, le=23)]
    """Pattern number within the image."""
    bits: Annotated[int, Field(ge=1, le=8)] = 8
    """Bit depth."""
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    """Checksum of the grey levels that the mirrors show."""

    @property
    def slot(self) -> Slot:
        return Slot(self.image, self.number, self.bits)

    @classmethod
    def of(cls, pattern: Pattern, image: int, number: int) -> FlashPattern:
        return cls(
            id=pattern.id,
            image=image,
            number=number,
            bits=pattern.bit_depth,
            sha256=index_checksum(shown_image(pattern)),
        )


class FlashIndex(Document):
    """All patterns in flash."""

    patterns: Annotated[tuple[FlashPattern, ...], Field(min_length=1)]
    """The patterns, in the order of their images."""

    @classmethod
    def of(cls, patterns: Sequence[Pattern], slots: Sequence[Slot]) -> FlashIndex:
        places = zip(patterns, slots, strict=True)
        return cls(patterns=tuple(FlashPattern.of(p, at.image, at.number) for p, at in places))

    @property
    def depths(self) -> set[int]:
        return {pattern.bits for pattern in self.patterns}

    def find(self, name: str, bits: int, sha256: str) -> FlashPattern | None:
        matching = [p for p in self.patterns if (p.bits, p.sha256) == (bits, sha256)]
        return next((p for p in matching if p.id == name), matching[0] if matching else None)
