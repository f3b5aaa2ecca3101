"""Motion over time with limited acceleration."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Ramp:
    """A motion along a line from rest to rest: it accelerates, keeps its speed, and decelerates."""

    distance_mm: float  # length in mm, 0 or more
    rate_mm_s: float  # greatest speed in mm/s, above 0
    acceleration_mm_s2: float  # acceleration and deceleration in mm/s², above 0

    @property
    def peak_mm_s(self) -> float:
        """Greatest speed reached in mm/s; on a short distance less than the rate."""
        return min(self.rate_mm_s, math.sqrt(self.acceleration_mm_s2 * self.distance_mm))

    @property
    def duration_s(self) -> float:
        """Time in s from rest to rest."""
        if self.distance_mm == 0.0:
            return 0.0
        return self.distance_mm / self.peak_mm_s + self.peak_mm_s / self.acceleration_mm_s2

    def travelled_mm(self, t_s: float) -> float:
        """Return the distance after a time."""
        if t_s >= self.duration_s:
            return self.distance_mm
        a, up_s = self.acceleration_mm_s2, self.peak_mm_s / self.acceleration_mm_s2
        if t_s < up_s:
            return a * t_s**2 / 2
        if t_s < self.duration_s - up_s:
            return self.peak_mm_s * (t_s - up_s / 2)
        return self.distance_mm - a * (self.duration_s - t_s) ** 2 / 2

    def speed_mm_s(self, t_s: float) -> float:
        """Return the speed after a time."""
        a = self.acceleration_mm_s2
        return max(0.0, min(self.peak_mm_s, a * t_s, a * (self.duration_s - t_s)))


@dataclass(frozen=True)
class Brake:
    """A deceleration to rest."""

    from_mm_s: float  # speed at its beginning in mm/s
    acceleration_mm_s2: float  # deceleration in mm/s²

    @property
    def distance_mm(self) -> float:
        """Distance in mm until rest."""
        return self.from_mm_s**2 / (2 * self.acceleration_mm_s2)

    @property
    def duration_s(self) -> float:
        """Time in s until rest."""
        return self.from_mm_s / self.acceleration_mm_s2

    def travelled_mm(self, t_s: float) -> float:
        """Return the distance after a time."""
        t_s = min(t_s, self.duration_s)
        return self.from_mm_s * t_s - self.acceleration_mm_s2 * t_s**2 / 2

    def speed_mm_s(self, t_s: float) -> float:
        """Return the speed after a time."""
        return max(0.0, self.from_mm_s - self.acceleration_mm_s2 * t_s)
