"""Simulations whose noise can be told what to follow from: common random numbers for comparisons."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, runtime_checkable


@runtime_checkable
class Seeded(Protocol):
    """A simulation whose noise follows from numbers that the caller gives.

    With the same numbers two candidates of a search differ by themselves and not by their noise.
    """

    def draw(self, numbers: Iterable[int]) -> None:
        """Let the noise of the next frames follow from these numbers and the world's seed.

        Called before the frames are acquired; what was left of earlier numbers is forgotten. Frames beyond
        the numbers follow from their own count.

        Parameters
        ----------
        numbers : iterable of int
            Not negative, one for each of the next frames.
        """
        ...
