"""The linear stage."""

from __future__ import annotations

import time
from abc import abstractmethod
from dataclasses import dataclass
from typing import final

from fpplab.core.errors import LimitError, StateError
from fpplab.devices.device import Device, State


@dataclass(frozen=True)
class StageCaps:
    """Travel of a stage in mm, (least, most)."""

    travel_mm: tuple[float, float]


class Stage(Device):
    """A linear stage in mm."""

    kind = "stage"
    _homed = False

    def _forget(self) -> None:
        self._homed = False

    @property
    @final
    def caps(self) -> StageCaps:
        """What it can do; known once open."""
        self._need(State.IDLE, doing="caps")
        with self._guard("caps"):
            return self._caps()

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
        """Go to an absolute position and return the position READ BACK, in mm.

        Raises `LimitError` outside the travel, `StateError` before homing, `DeviceTimeoutError`.
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
        """Refuse a position outside the travel: `LimitError`; nothing moves."""
        self._need(State.IDLE, doing="check")
        self._check_travel("check", mm)

    def _check_travel(self, doing: str, mm: float) -> None:
        least, most = self.caps.travel_mm
        if not least <= mm <= most:
            raise LimitError(
                self.name, doing, f"{mm:g} mm was asked for", f"the travel is {least:g} to {most:g} mm"
            )

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
    def _caps(self) -> StageCaps: ...

    @abstractmethod
    def _home(self) -> None: ...

    @abstractmethod
    def _move_to(self, mm: float, deadline_s: float) -> None:
        """Move, and return once there; raise `DeviceTimeoutError` at `deadline_s` of `time.monotonic`."""

    @abstractmethod
    def _position_mm(self) -> float: ...

    @abstractmethod
    def _halt(self) -> None: ...
