"""Simulations with reproducible noise: common random numbers for comparisons."""

from __future__ import annotations

from collections.abc import Iterable
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
