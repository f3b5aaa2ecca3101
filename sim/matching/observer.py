"""What follows a matching: progress bars, the viewer, or a program of one's own."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

from fpplab.core.progress import Progress, Say, ignore, no_progress
from fpplab.results.observer import Observer

if TYPE_CHECKING:
    from sim.matching.record import MatchingEpoch
    from sim.matching.reference import Reference
    from sim.twin import Twin


class MatchObserver(Observer):
    """Follows a matching. Each method may be overridden; here they do nothing."""

    def work(self, name: str) -> AbstractContextManager[tuple[Progress, Say]]:
        """Enter long work, which reports the share that is done and, as text, what is being done."""
        return nullcontext((no_progress, ignore))

    def epoch(self, epoch: MatchingEpoch, reference: Reference, twin: Twin) -> None:
        """Take an epoch as it ends, with the bench's recordings and the twin that was tried."""
