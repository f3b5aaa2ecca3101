"""Clocks that a driver and an emulated device share: real time, or simulated time for tests."""

import time
from dataclasses import dataclass
from typing import Protocol

ROUNDING_S = 1e-9
"""Tolerance in s where times that are equal but for rounding are compared: sums of floats up to days."""


@dataclass(frozen=True)
class Polling:
    """How a change of a device's state is awaited."""

    step_s: float  # from one query to the next
    limit_s: float  # after which the device is taken not to change


class Clock(Protocol):
    """Source of time for drivers and emulators, in seconds from an arbitrary origin."""

    def now(self) -> float:
        """Seconds from the clock's origin, which never decrease."""

    def sleep(self, seconds: float) -> None:
        """Block until so many seconds have passed on this clock."""


class RealClock:
    """The computer's monotonic clock."""

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


class SteppedClock:
    """Simulated clock that advances only by `sleep`: faster than real time, and always the same."""

    def __init__(self) -> None:
        self._now_s = 0.0

    def now(self) -> float:
        return self._now_s

    def sleep(self, seconds: float) -> None:
        self._now_s += max(0.0, seconds)
