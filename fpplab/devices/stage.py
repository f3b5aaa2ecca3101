"""A stage: one axis that moves along a line, or turns."""

import time
from abc import abstractmethod
from dataclasses import dataclass
from typing import Literal, final

from fpplab.core.confirmation import ConfirmationRequired, confirm, how_to_confirm
from fpplab.core.errors import LimitError, StateError
from fpplab.devices.device import Device, State


@dataclass(frozen=True)
class StageCaps:
    """What a stage can do."""

    travel_mm: tuple[float, float]  # (minimum, maximum) position in mm, or of a turning axis in degrees
    unit: Literal["mm", "deg"] = "mm"


@dataclass(frozen=True)
class StageMove:
    """A move that has not been made."""

    start_mm: float | None  # where the stage is; None where it has to be homed first
    target_mm: float  # where it would go
    travel_mm: tuple[float, float]  # (minimum, maximum) position that it can reach
    soft_limits_mm: tuple[float, float] | None  # those that the rig file allows without consent
    needs_consent: bool  # whether the target lies beyond the soft limits


class Stage(Device):
    """One axis: a linear one in mm, or a turning one, whose `StageCaps.unit` is "deg" and all mm are degrees.

    Each axis of a device with several is a stage of its own; they share a connection through the rig file's
    `bench`, or by the driver's own means.
    """

    kind = "stage"
    soft_limits_mm: tuple[float, float] | None = None
    """Positions in mm that are exceeded only with consent; None where only the travel limits it."""
    _homed = False

    def _forget(self) -> None:
        self._homed = False
        self._agreed_mm: set[float] = set()

    @property
    @final
    def caps(self) -> StageCaps:
        """What it can do; known once open."""
        self._need(State.IDLE, doing="caps")
        with self._guard("caps"):
            return self._of_kind(StageCaps, self._caps(), "_caps")

    @property
    @final
    def homed(self) -> bool:
        """Whether it has found its reference since it was opened."""
        return self._homed

    @final
    def home(self) -> None:
        """Find the reference; moves are refused before."""
        self._need(State.IDLE, doing="home")
        self._homed = False
        with self._guard("home"):
            self._home()
        self._homed = True

    @final
    def move_to(self, mm: float, timeout_s: float = 60.0) -> float:
        """Go to an absolute position and return the position READ BACK.

        Parameters
        ----------
        mm : float
            Where to, in mm.
        timeout_s : float
            Longest time in s that it may take.

        Returns
        -------
        float
            Where it is, in mm, as the device reports.

        Raises
        ------
        LimitError
            The position lies outside the travel, or outside the soft limits without consent.
        StateError
            The stage is not homed.
        DeviceTimeoutError
            It did not arrive in time.
        """
        self._need(State.IDLE, doing="move_to")
        self._check_travel("move_to", mm)
        if not self._homed:
            raise StateError(self.name, "move_to", "is not homed", "home it first")
        with self._guard("move_to"):
            self._move_to(mm, time.monotonic() + timeout_s)
            return self._position_mm()

    @final
    def check(self, mm: float) -> None:
        """Refuse a position outside the travel; nothing moves.

        Parameters
        ----------
        mm : float
            The position in mm.

        Raises
        ------
        LimitError
            It lies outside, or outside the soft limits without consent.
        """
        self._need(State.IDLE, doing="check")
        self._check_travel("check", mm)

    @final
    def plan_move(self, mm: float) -> StageMove:
        """Describe a move to a position; nothing moves, and no confirmation is asked for.

        Parameters
        ----------
        mm : float
            The position in mm.

        Returns
        -------
        StageMove
            The move.

        Raises
        ------
        LimitError
            The position lies outside the travel.
        """
        self._need(State.IDLE, doing="plan_move")
        self._check_reach("plan_move", mm)
        start_mm = self.position_mm if self._homed else None
        beyond = self._is_beyond_soft_limits(mm)
        return StageMove(start_mm, mm, self.caps.travel_mm, self.soft_limits_mm, beyond)

    def _check_travel(self, doing: str, mm: float) -> None:
        self._check_reach(doing, mm)
        self._check_soft_limits(doing, mm)

    def _check_reach(self, doing: str, mm: float) -> None:
        (lower, upper), unit = self.caps.travel_mm, self.caps.unit
        if not lower <= mm <= upper:
            raise LimitError(
                self.name,
                doing,
                f"{mm:g} {unit} was asked for",
                f"the travel is {lower:g} to {upper:g} {unit}",
            )

    def _is_beyond_soft_limits(self, mm: float) -> bool:
        limits = self.soft_limits_mm
        return limits is not None and not limits[0] <= mm <= limits[1]

    def _check_soft_limits(self, doing: str, mm: float) -> None:
        if self.soft_limits_mm is None or mm in self._agreed_mm or not self._is_beyond_soft_limits(mm):
            return
        lower, upper = self.soft_limits_mm
        act = ConfirmationRequired.BEYOND_SOFT_LIMITS
        unit = self.caps.unit
        reason = f"{mm:g} {unit} lies beyond the soft limits of the rig file, {lower:g} to {upper:g} {unit}"
        if not confirm(act, f"{self.name}: {reason}."):
            raise LimitError(self.name, doing, reason, how_to_confirm(act))
        self._agreed_mm.add(mm)  # who confirm to go there is not asked again

    @property
    @final
    def position_mm(self) -> float:
        """Where it is, read from the device."""
        self._need(State.IDLE, doing="position")
        with self._guard("position"):
            return self._position_mm()

    @final
    def halt(self) -> None:
        """Stop at once; the reference may be lost, so home again."""
        self._need(State.IDLE, State.ARMED, doing="halt")
        self._homed = False
        with self._guard("halt"):
            self._halt()

    @abstractmethod
    def _caps(self) -> StageCaps:
        """Tell what this stage can do; called by `caps` in IDLE, before every move.

        Returns
        -------
        StageCaps
            Its travel in mm.
        """

    @abstractmethod
    def _home(self) -> None:
        """Find the reference and return once it is found; called by `home` in IDLE.

        Afterwards positions are absolute.

        Raises
        ------
        DeviceError
            It was not found; the stage then counts as not homed.
        """

    @abstractmethod
    def _move_to(self, mm: float, deadline_s: float) -> None:
        """Move to an absolute position in mm, and return once at rest there.

        Called by `move_to` in IDLE, homed. The position is read back afterwards through `_position_mm`::

            def _move_to(self, mm, deadline_s):
                self._send(f"G0 X{mm:.4f}")
                while self._moving():
                    if time.monotonic() > deadline_s:
                        self._halt()
                        raise DeviceTimeoutError(self.name, "move_to", f"is at {self._position_mm():g} mm")

        Parameters
        ----------
        mm : float
            Where to, in mm, within the travel.
        deadline_s : float
            Until when it may take, in s of `time.monotonic`.

        Raises
        ------
        DeviceTimeoutError
            It has not arrived at the deadline; the stage has been braked.
        """

    @abstractmethod
    def _position_mm(self) -> float:
        """Ask the device where the stage is; called by `position_mm` and after moves.

        Returns
        -------
        float
            Its position in mm.

        Raises
        ------
        DeviceError
            It does not answer, or the position is not known.
        """

    @abstractmethod
    def _halt(self) -> None:
        """Stop at once; called by `halt` in IDLE and ARMED, also from another thread's interruption.

        Raises
        ------
        DeviceError
            It may still be moving.
        """
