"""Motors and rail: the position that the controller counts, and where the carriage really is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from drivers.emulators.grbl.gcode import AxisPositions, Move
from drivers.emulators.grbl.ramps import Brake, Ramp
from drivers.emulators.grbl.settings import GrblSettings


@dataclass(frozen=True)
class Rail:
    """The mechanics, which the controller does not know.

    Lengths count from the home switch, away from it.

    Attributes
    ----------
    axis : int
        The rail's axis of the machine: 0, 1 or 2.
    length_mm : float
        Position of the far end stop in mm; the near one is 1 mm behind the switch.
    start_mm : float
        Position of the carriage at first in mm.
    """

    axis: int = 0
    length_mm: float = 205.0
    start_mm: float = 42.0

    def clamp(self, mm: float) -> float:
        """Limit a position of the carriage to the range between the end stops.

        Parameters
        ----------
        mm : float
            Position to which it is pushed, in mm.

        Returns
        -------
        float
            Position that it reaches, in mm.
        """
        return min(max(mm, -1.0), self.length_mm)


@dataclass(frozen=True)
class Motion:
    """One move under way.

    Attributes
    ----------
    origin : AxisPositions
        Machine position in mm where it began.
    target : AxisPositions
        Machine position in mm where it ends.
    ramp : Ramp or Brake
        Its speed over time.
    began_s : float
        Time in s when it began.
    """

    origin: AxisPositions
    target: AxisPositions
    ramp: Ramp | Brake
    began_s: float

    @property
    def ends_s(self) -> float:
        """Time in s when it comes to rest."""
        return self.began_s + self.ramp.duration_s

    def position_after(self, travelled_mm: float) -> AxisPositions:
        """Return the position at a distance from the origin.

        Parameters
        ----------
        travelled_mm : float
            Distance along the line in mm.

        Returns
        -------
        AxisPositions
            Machine position in mm.
        """
        share = travelled_mm / self.ramp.distance_mm
        x, y, z = (a + share * (b - a) for a, b in zip(self.origin, self.target, strict=True))
        return x, y, z

    def position_at(self, now: float) -> AxisPositions:
        """Return the position at a time.

        Parameters
        ----------
        now : float
            Time in s, not before it began.

        Returns
        -------
        AxisPositions
            Machine position in mm.
        """
        return (
            self.target
            if now >= self.ends_s
            else self.position_after(self.ramp.travelled_mm(now - self.began_s))
        )


class Drive:
    """Counts steps as a controller does; the carriage follows as far as the rail lets it.

    Parameters
    ----------
    settings : GrblSettings
        Of the controller.
    rail : Rail
        The mechanics.

    Attributes
    ----------
    carriage_mm : float
        True position of the carriage in mm, from the switch.
    switch_works : bool
        Set to False for a switch that never closes.
    switch_sticks : bool
        Set to True for a switch that never opens.
    motion : Motion or None
        The move under way.
    """

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
        """Whether the home switch is closed."""
        return self.switch_sticks or (self.switch_works and self.carriage_mm <= 0.0)

    def forget_position(self) -> None:
        """Stop at once, and count steps from zero."""
        self.motion, self._steps = None, [0, 0, 0]

    def lose_steps(self, mm: float) -> None:
        """Shift the carriage against the motor, as lost steps do.

        Parameters
        ----------
        mm : float
            Shift in mm, away from the switch.
        """
        self.carriage_mm = self._rail.clamp(self.carriage_mm + mm)

    def call_at(self, mm: float, action: Callable[[], None]) -> None:
        """Call a function once, when a motion passes a position.

        Parameters
        ----------
        mm : float
            Machine position in mm on the rail's axis.
        action : callable
            Takes no arguments.
        """
        self._crossings.append((mm, action))

    def begin(self, move: Move, at_s: float) -> None:
        """Start a move; a move of no length is left out.

        Parameters
        ----------
        move : Move
            Target and rate.
        at_s : float
            Time in s when it begins.
        """
        ways = [abs(b - a) for a, b in zip(self.position, move.target, strict=True)]
        length = math.dist(self.position, move.target)
        if length == 0.0:
            return
        moving = [(i, way / length) for i, way in enumerate(ways) if way]
        rate = min(self._settings.rate_mm_s(i) / share for i, share in moving)
        acceleration = min(self._settings.acceleration_mm_s2(i) / share for i, share in moving)
        ramp = Ramp(length, min(rate, move.rate_mm_s or rate), acceleration)
        self.motion = Motion(self.position, move.target, ramp, at_s)

    def brake(self, now: float) -> Move | None:
        """Slow the present move down to rest.

        Parameters
        ----------
        now : float
            Present time in s.

        Returns
        -------
        Move or None
            The rest of the move; None if there is none.
        """
        motion = self.motion
        if motion is None or not isinstance(motion.ramp, Ramp):
            return None
        ramp, elapsed = motion.ramp, now - motion.began_s
        brake = Brake(ramp.speed_mm_s(elapsed), ramp.acceleration_mm_s2)
        gone = min(ramp.travelled_mm(elapsed) + brake.distance_mm, ramp.distance_mm)
        slows = brake.distance_mm > 0.0
        self.motion = (
            Motion(motion.position_at(now), motion.position_after(gone), brake, now) if slows else None
        )
        return Move(motion.target, ramp.rate_mm_s) if gone < ramp.distance_mm else None

    def update(self, now: float) -> bool:
        """Move steps and carriage to where the present motion is.

        Parameters
        ----------
        now : float
            Present time in s.

        Returns
        -------
        bool
            True if that has just closed the home switch.
        """
        assert self.motion is not None
        before, free = self.position[self.axis], not self.switch_pressed
        target = self.motion.position_at(now)
        self._steps = [round(mm * self._settings.steps_per_mm(i)) for i, mm in enumerate(target)]
        after = self.position[self.axis]
        self.carriage_mm = self._rail.clamp(self.carriage_mm + self._away * (after - before))
        self._run_crossing_actions(before, after)
        return free and self.switch_pressed

    def speed_mm_s(self, now: float) -> float:
        """Return the present speed.

        Parameters
        ----------
        now : float
            Present time in s.

        Returns
        -------
        float
            Speed in mm/s, 0 at rest.
        """
        return self.motion.ramp.speed_mm_s(now - self.motion.began_s) if self.motion else 0.0

    def homing_cycle(self) -> tuple[float, float, int | None]:
        """Predict a homing cycle from the present position.

        It consists of search, pull-off, slow approach and a pull-off, with a pause after each ($24 to $27).

        Returns
        -------
        duration_s : float
            How long it takes in s.
        carriage_mm : float
            Where it leaves the carriage, in mm from the switch.
        alarm : int or None
            Number of the alarm by which it fails; None if it succeeds.
        """
        pull_off, seek, slow = self._settings[27], self._settings[25] / 60, self._settings[24] / 60
        search, way = 1.5 * self._settings.travel_mm(self.axis), max(0.0, self.carriage_mm)
        if self.switch_sticks:
            return (
                self._legs([(0.0, seek), (pull_off, seek)]),
                self._rail.clamp(self.carriage_mm + pull_off),
                8,
            )
        if not self.switch_works or way > search:
            return self._legs([(search, seek)]), self._rail.clamp(self.carriage_mm - search), 9
        legs = [(way, seek), (pull_off, seek), (pull_off, slow), (pull_off, seek)]
        return self._legs(legs), pull_off, None

    def set_home(self, carriage_mm: float, at_zero: bool) -> None:
        """End a homing cycle: the position becomes known.

        Parameters
        ----------
        carriage_mm : float
            Where the cycle leaves the carriage, in mm from the switch.
        at_zero : bool
            Whether the machine position becomes 0, at whichever end the switch is.
        """
        down = self._settings.homes_down(self.axis)
        switch = -self._settings.travel_mm(self.axis) if down else 0.0
        home = 0.0 if at_zero else switch + self._away * self._settings[27]
        self._steps[self.axis] = round(home * self._settings.steps_per_mm(self.axis))
        self.carriage_mm = carriage_mm

    @property
    def _away(self) -> int:
        """Sign of the machine axis in the direction away from the switch."""
        return 1 if self._settings.homes_down(self.axis) else -1

    def _legs(self, legs: list[tuple[float, float]]) -> float:
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
