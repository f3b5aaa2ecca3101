"""Motors and rail: the position that the controller counts, and where the carriage really is."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from drivers.emulators.grbl.gcode import AxisPositions, Move

DEFAULTS: dict[int, float] = {
    0: 10, 1: 25, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.010, 12: 0.002, 13: 0,
    20: 1, 21: 1, 22: 1, 23: 0, 24: 60.0, 25: 600.0, 26: 250, 27: 2.0, 30: 1000.0, 31: 0.0, 32: 0,
    100: 400.0, 101: 400.0, 102: 400.0, 110: 1200.0, 111: 1200.0, 112: 1200.0,
    120: 100.0, 121: 100.0, 122: 100.0, 130: 200.0, 131: 200.0, 132: 200.0,
}  # fmt: skip
"""Settings by number, for a rail of 200 mm with a screw of 4 mm pitch and 1600 microsteps per revolution."""

_WITH_DECIMALS = {11, 12, 24, 25, 27, *range(100, 133)}


class GrblSettings(dict[int, float]):
    """Settings by number, and what they mean for one axis, 0 … 2."""

    def report_lines(self) -> list[str]:
        """Compose the answer to `$$`."""
        return [
            f"${n}={value:.3f}" if n in _WITH_DECIMALS else f"${n}={value:.0f}" for n, value in self.items()
        ]

    def flag(self, number: int) -> bool:
        return bool(self[number])

    def homes_down(self, axis: int) -> bool:
        """Return whether the home switch is at the negative end of an axis ($23)."""
        return bool(int(self[23]) >> axis & 1)

    def steps_per_mm(self, axis: int) -> float:
        """Return the resolution of an axis ($100 … $102)."""
        return self[100 + axis]

    def rate_mm_s(self, axis: int) -> float:
        """Return the greatest speed of an axis ($110 … $112, which are in mm/min)."""
        return self[110 + axis] / 60

    def acceleration_mm_s2(self, axis: int) -> float:
        """Return the greatest acceleration of an axis ($120 … $122)."""
        return self[120 + axis]

    def travel_mm(self, axis: int) -> float:
        """Return the greatest travel of an axis ($130 … $132)."""
        return self[130 + axis]


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
        return self.from_mm_s**2 / (2 * self.acceleration_mm_s2)

    @property
    def duration_s(self) -> float:
        return self.from_mm_s / self.acceleration_mm_s2

    def travelled_mm(self, t_s: float) -> float:
        t_s = min(t_s, self.duration_s)
        return self.from_mm_s * t_s - self.acceleration_mm_s2 * t_s**2 / 2

    def speed_mm_s(self, t_s: float) -> float:
        return max(0.0, self.from_mm_s - self.acceleration_mm_s2 * t_s)


@dataclass(frozen=True)
class Rail:
    """The mechanics, unknown to the controller; lengths count from the home switch, away from it."""

    axis: int = 0  # the rail's axis of the machine: 0, 1 or 2
    length_mm: float = 205.0  # position of the far end stop in mm; the near one is 1 mm behind the switch
    start_mm: float = 42.0  # position of the carriage at first in mm

    def clamp(self, mm: float) -> float:
        """Limit a position of the carriage to the range between the end stops."""
        return min(max(mm, -1.0), self.length_mm)


@dataclass(frozen=True)
class Motion:
    """A motion under way along one axis."""

    axis: int  # 0, 1 or 2
    origin_mm: float  # machine position where it began
    target_mm: float  # machine position where it ends
    ramp: Ramp | Brake  # its speed over time
    began_s: float  # time when it began

    @property
    def ends_s(self) -> float:
        """Time in s when it comes to rest."""
        return self.began_s + self.ramp.duration_s

    def position_mm(self, now: float) -> float:
        if now >= self.ends_s:
            return self.target_mm
        share = self.ramp.travelled_mm(now - self.began_s) / self.ramp.distance_mm
        return self.origin_mm + share * (self.target_mm - self.origin_mm)


class Drive:
    """Counts steps as a controller does; the carriage follows as far as the rail lets it."""

    def __init__(self, settings: GrblSettings, rail: Rail) -> None:
        self._settings, self._rail = settings, rail
        self._steps = [0, 0, 0]
        self._crossings: list[tuple[float, Callable[[], None]]] = []
        self.carriage_mm = rail.start_mm
        self.switch_works, self.switch_sticks = True, False
        self.motion: Motion | None = None

    @property
    def axis(self) -> int:
        """The rail's axis: 0, 1 or 2."""
        return self._rail.axis

    @property
    def position(self) -> AxisPositions:
        """Machine position in mm by the steps counted."""
        x, y, z = (steps / self._settings.steps_per_mm(i) for i, steps in enumerate(self._steps))
        return x, y, z

    @property
    def switch_pressed(self) -> bool:
        return self.switch_sticks or (self.switch_works and self.carriage_mm <= 0.0)

    def forget_position(self) -> None:
        """Stop at once, and count steps from zero."""
        self.motion, self._steps = None, [0, 0, 0]

    def lose_steps(self, mm: float) -> None:
        """Shift the carriage against the motor, as lost steps do."""
        self.carriage_mm = self._rail.clamp(self.carriage_mm + mm)

    def call_at(self, mm: float, action: Callable[[], None]) -> None:
        """Call a function once, when a motion passes a position."""
        self._crossings.append((mm, action))

    def begin(self, move: Move, at_s: float, rate_mm_s: float = math.inf) -> None:
        """Start a move, as fast as the settings or a lower rate allow; a move of no length is left out."""
        axis, origin_mm = move.axis, self.position[move.axis]
        if move.target_mm == origin_mm:
            return
        rate_mm_s = min(rate_mm_s, self._settings.rate_mm_s(axis))
        ramp = Ramp(abs(move.target_mm - origin_mm), rate_mm_s, self._settings.acceleration_mm_s2(axis))
        self.motion = Motion(axis, origin_mm, move.target_mm, ramp, at_s)

    def brake(self, now: float) -> None:
        motion = self.motion
        if motion is None or not isinstance(motion.ramp, Ramp):
            return
        brake = Brake(motion.ramp.speed_mm_s(now - motion.began_s), motion.ramp.acceleration_mm_s2)
        if brake.distance_mm == 0.0:
            self.motion = None
            return
        here_mm = motion.position_mm(now)
        way_mm = math.copysign(brake.distance_mm, motion.target_mm - motion.origin_mm)
        self.motion = Motion(motion.axis, here_mm, here_mm + way_mm, brake, now)

    def update(self, now: float) -> bool:
        """Move steps and carriage to where the present motion is; return whether the switch closes."""
        assert self.motion is not None
        was_pressed = self.switch_pressed
        before_mm = self.position[self.axis]
        moving = self.motion.axis
        self._steps[moving] = round(self.motion.position_mm(now) * self._settings.steps_per_mm(moving))
        after_mm = self.position[self.axis]
        self.carriage_mm = self._rail.clamp(self.carriage_mm + self._away * (after_mm - before_mm))
        self._run_crossing_actions(before_mm, after_mm)
        return self.switch_pressed and not was_pressed

    def speed_mm_s(self, now: float) -> float:
        return self.motion.ramp.speed_mm_s(now - self.motion.began_s) if self.motion else 0.0

    def homing_cycle(self) -> tuple[float, float, int | None]:
        """Predict a homing cycle from the present position."""
        # It consists of search, pull-off, slow approach and a pull-off, with a pause after each ($24 to $27).
        pull_off, seek, slow = self._settings[27], self._settings[25] / 60, self._settings[24] / 60
        search, way = 1.5 * self._settings.travel_mm(self.axis), max(0.0, self.carriage_mm)
        if self.switch_sticks:
            return (
                self._legs_duration_s([(0.0, seek), (pull_off, seek)]),
                self._rail.clamp(self.carriage_mm + pull_off),
                8,
            )
        if not self.switch_works or way > search:
            return self._legs_duration_s([(search, seek)]), self._rail.clamp(self.carriage_mm - search), 9
        legs = [(way, seek), (pull_off, seek), (pull_off, slow), (pull_off, seek)]
        return self._legs_duration_s(legs), pull_off, None

    def finish_homing(self, carriage_mm: float, reads_zero: bool) -> None:
        """End a homing cycle; the axis then reads 0, or the place that the switch stands for."""
        down = self._settings.homes_down(self.axis)
        switch = -self._settings.travel_mm(self.axis) if down else 0.0
        home = 0.0 if reads_zero else switch + self._away * self._settings[27]
        self._steps[self.axis] = round(home * self._settings.steps_per_mm(self.axis))
        self.carriage_mm = carriage_mm

    @property
    def _away(self) -> int:
        """Sign of the machine axis in the direction away from the switch."""
        return 1 if self._settings.homes_down(self.axis) else -1

    def _legs_duration_s(self, legs: list[tuple[float, float]]) -> float:
        """Return the time in s of (length, rate) legs from rest to rest, with a pause after each."""
        acceleration, pause = self._settings.acceleration_mm_s2(self.axis), self._settings[26] / 1000
        return sum(Ramp(mm, rate, acceleration).duration_s + pause for mm, rate in legs)

    def _run_crossing_actions(self, before: float, after: float) -> None:
        if before == after:
            return
        passed = [c for c in self._crossings if min(before, after) <= c[0] <= max(before, after)]
        for crossing in passed:
            self._crossings.remove(crossing)
            crossing[1]()
