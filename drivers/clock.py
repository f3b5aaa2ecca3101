"""The time that a driver and the far end of its wire share: the computer's, or one that only tests move."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Seconds from an arbitrary beginning."""

    def now(self) -> float:
        """The time."""

    def sleep(self, seconds: float) -> None:
        """Return that much later."""


class RealClock:
    """The computer's monotonic clock."""

    def now(self) -> float:
        """The time."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Return that much later."""
        time.sleep(seconds)


class SteppedClock:
    """A clock that goes on only when somebody sleeps: hours of a bench in a moment, and always the same."""

    def __init__(self) -> None:
        self._now_s = 0.0

    def now(self) -> float:
        """The time."""
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Make it that much later."""
        self._now_s += max(0.0, seconds)
