"""The arrangement of a projector's mirrors, by itself: options of commands name it without loading NumPy."""

from enum import StrEnum


class Lattice(StrEnum):
    """Arrangement of a projector's mirrors."""

    SQUARE = "square"
    DIAMOND = "diamond"
