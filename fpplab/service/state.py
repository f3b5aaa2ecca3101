"""How far an ordered scan is, for the service and its clients."""

from enum import StrEnum
from typing import Self


class ScanState(StrEnum):
    """How far a scan is; each of the first five follows the one before it."""

    QUEUED = "queued"
    RUNNING = "running"
    EXPOSED = "exposed"  # the last exposure is over
    JUDGED = "judged"  # points and verdict are known
    FINISHED = "finished"
    FAILED = "failed"
    CANCELLED = "cancelled"
    INTERRUPTED = "interrupted"  # the service ended; the same order completes it

    @property
    def has_ended(self) -> bool:
        return self in (self.FINISHED, self.FAILED, self.CANCELLED, self.INTERRUPTED)

    def reaches(self, until: Self) -> bool:
        """Whether a scan is so far that nobody waits for a state any longer."""
        place = {state: number for number, state in enumerate(FOLLOWING)}
        return place.get(self, len(FOLLOWING)) >= place.get(until, len(FOLLOWING))


FOLLOWING = tuple(ScanState)[:5]  # states that follow each other
