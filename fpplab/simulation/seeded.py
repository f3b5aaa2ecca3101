"""Simulations with reproducible noise: common random numbers for comparisons."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol, runtime_checkable


@runtime_checkable
class Seeded(Protocol):
    """A simulation whose noise follows from random seeds that the caller gives.

    `fpplab optimise` uses it (common random numbers): with the same numbers two candidates of a search differ
    by their plans and not by the realisation of the noise.

    Examples
    --------
    >>> rig.simulation.draw(range(plan.images))
    >>> frames = list(capture(rig, plan))
    """

    def draw(self, numbers: Iterable[int]) -> None:
        """Let the noise of the next frames follow from these numbers and the world's seed.

        Called before frames are acquired. Numbers left over from an earlier call are discarded; frames beyond
        the numbers follow from their own count.

        Parameters
        ----------
        numbers : iterable of int
            Not negative, one for each of the next frames.
        """
        ...


@runtime_checkable
class NumberedFrames(Protocol):
    """A simulation whose frames are numbered, so that an interrupted session goes on as if it had not been.

    The noise of a frame follows from its number. A session records the number of its first frame; whoever
    completes it, later and in another process, gives its frames the numbers that they would have had.
    """

    @property
    def next_frame(self) -> int:
        """Number of the next frame, counted since opening."""
        ...

    def number_frames(self, numbers: Sequence[int], then: int) -> None:
        """Give the next frames these numbers.

        Parameters
        ----------
        numbers : sequence of int
            Not negative, one for each of the next frames.
        then : int
            Number of the frame that follows them, from which is counted on.
        """
        ...
