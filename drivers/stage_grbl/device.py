"""A linear stage behind a GRBL 1.1 controller.

The stage's zero is the position where homing ends, and its coordinate increases away from the home switch,
whichever way the controller's own axis points. Moves use machine coordinates (G53), so that a work offset
left by another program has no effect.

GRBL counts the steps that it sends and has no position encoder: it cannot know that a motor has stalled or
slipped. What it can detect is reported: alarms and restarts, a move that ends at another position, a stage
that was moved by something else, and a home switch that is pressed where it should be free.
"""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from typing import Any, Literal

from serial.tools import list_ports

from drivers.stage_grbl.lines import AXES, HOLD, Axes, StatusReport
from drivers.stage_grbl.wire import ANSWER_S, START_S, GrblWire, RestartedError
from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.errors import ConfigError, DeviceError, DeviceTimeoutError, DisconnectedError, ProtocolError
from fpplab.core.units import MM_PER_INCH
from fpplab.devices import DeviceInfo, Stage, StageCaps

FORCES_ORIGIN = "Z"  # build option of a controller whose machine position is 0 where homing ends
POLL_S = 0.05  # interval of status queries in s (chosen)
HOME, AFTER_MOTION = "$H", "G4P0"
"""Lines to home, and to wait for the end of all motion.

`G4P0` is a pause of zero length, which is answered when all motion has ended; a move is answered as soon as
it is planned.
"""
REPORTS_PER_OFFSET = 30
"""GRBL sends the work coordinate offset at least once in this many reports (config.h, in motion)."""
DIGIT_MM, DIGIT_INCH = 0.001, 0.0001
"""Last digit of a reported position, in mm or inches (GRBL's interface documentation)."""
OTHER_PROGRAM_REMEDY = "close other programs that move the stage, then close, open and home it again"


class StageOptions(Document):
    """The stage's section in a rig file."""

    port: str | None = None
    """Serial port, such as /dev/ttyACM0 or COM3; without it, the rig's bench provides one as `stage_port`."""
    axis: Literal["X", "Y", "Z"] = "X"
    """The controller's axis that moves the stage."""


@dataclass(frozen=True)
class Mechanics:
    """Properties of the axis, derived from the controller's settings."""

    step_mm: float  # length of one motor step in mm
    usable_mm: float  # travel in mm from the position where homing ends
    direction: int  # sign of the machine axis in the direction away from the home switch, 1 or -1
    braking_s: float  # longest time from full speed to rest, in s
    homing_s: float  # longest time of a homing cycle, in s
    unit_mm: float  # unit of reported positions in mm: 1 or 25.4
    rounding_mm: float  # half the last digit of a reported position, in mm
    home_mm: float  # machine position in mm at the end of homing

    @classmethod
    def of(cls, settings: dict[int, float], axis: int) -> Mechanics:
        unit_mm, digit = (MM_PER_INCH, DIGIT_INCH) if settings[13] else (1.0, DIGIT_MM)
        step_mm, pull_off_mm = 1.0 / settings[100 + axis], settings[27]
        seek_mm_s, slow_mm_s, pause_s = settings[25] / 60, settings[24] / 60, settings[26] / 1000
        search_s = 1.5 * sum(settings[130 + i] for i in range(len(AXES))) / seek_mm_s
        pull_offs_s = len(AXES) * (3 * pull_off_mm / slow_mm_s + 4 * pause_s)
        switch_low = bool(int(settings[23]) >> axis & 1)
        return cls(
            step_mm=step_mm,
            # Homing ends at a whole step; one step less keeps the far end inside GRBL's own limit.
            usable_mm=settings[130 + axis] - pull_off_mm - step_mm,
            direction=1 if switch_low else -1,
            braking_s=settings[110 + axis] / 60 / settings[120 + axis],
            homing_s=2 * (search_s + pull_offs_s) + ANSWER_S,  # twice, for speeding up and slowing down
            unit_mm=unit_mm,
            rounding_mm=unit_mm * digit / 2,
            home_mm=pull_off_mm - settings[130 + axis] if switch_low else -pull_off_mm,
        )

    @property
    def tolerance_mm(self) -> float:
        """Largest accepted distance from a target in mm: half a step, and the rounding of positions."""
        return self.step_mm / 2 + self.rounding_mm + 1e-4


class GrblStage(Stage):
    """One axis of a GRBL 1.1 controller whose homing cycle is compiled for the axes that have a switch."""

    _wire: GrblWire | None = None
    _mechanics: Mechanics | None = None
    _moving = False

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        self._options = config.validate(options, StageOptions, self.name)
        self._bench = bench
        self._axis = AXES.index(self._options.axis)

    def _open(self) -> None:
        self._port = self._options.port or getattr(self._bench, "stage_port", None)
        if self._port is None:
            raise ConfigError(f"{self.name}: 'port' is missing; `fpplab devices` lists the serial ports")
        self._moving, self._mechanics = False, None
        self._offset: Axes | None = None
        self._home_mm = 0.0
        self._rest_mm: float | None = None
        wire = GrblWire(self.name, self._port)
        try:
            self._version = self._reset(wire)
        except BaseException:
            wire.close()  # no controller answers, so there is no motion to stop
            raise
        self._wire = wire
        try:
            self._mechanics = self._read_mechanics(wire.settings("open"))
        except RestartedError:  # that welcome message was an earlier one; the reset's own has come now
            self._reset(wire)
            self._mechanics = self._read_mechanics(wire.settings("open"))

    def _reset(self, wire: GrblWire) -> str:
        version = wire.reset("open", START_S)
        if not re.fullmatch(r"1\.1[a-z]?", version):
            raise DeviceError(self.name, "open", f"speaks GRBL {version}", "put GRBL 1.1 on the controller")
        return version

    def _read_mechanics(self, settings: dict[int, float]) -> Mechanics:
        try:
            mechanics = Mechanics.of(settings, self._axis)
        except (KeyError, ZeroDivisionError) as error:
            raise ProtocolError(
                self.name, "open", f"its settings ($$) are incomplete or zero ({error})", "correct them"
            ) from error
        if mechanics.usable_mm <= 0:
            travel, pull_off = f"${130 + self._axis}={settings[130 + self._axis]:g}", f"$27={settings[27]:g}"
            raise DeviceError(
                self.name, "open", f"the travel {travel} is within the pull-off {pull_off}", "correct them"
            )
        if not settings.get(22):
            raise DeviceError(
                self.name,
                "open",
                "homing is switched off ($22=0), and without it no position is known",
                f"fit a home switch, and set $22=1 and the travel, ${130 + self._axis}",
            )
        return mechanics

    def _close(self) -> None:
        wire, self._wire = self._wire, None
        if wire is None:
            return
        try:
            self._stop(wire, "close")
        except DisconnectedError:
            if self._moving:  # a stage at rest is safe
                raise
        finally:
            wire.close()

    def _info(self) -> DeviceInfo:
        serials = [port.serial_number for port in list_ports.comports() if port.device == self._port]
        serial = next((number for number in serials if number), "")
        return DeviceInfo("stage", f"GRBL {self._version}", serial, f"serial {self._port}")

    def _caps(self) -> StageCaps:
        return StageCaps((0.0, self._open_mechanics.usable_mm))

    def _home(self) -> None:
        wire, self._rest_mm = self._open_wire, None
        wire.send("home", HOME)
        self._moving = True
        wire.await_ok("home", HOME, self._open_mechanics.homing_s)
        self._moving = False
        report = self._at_rest("home")
        self._check_switch("home", report)
        self._check_homed(self._machine_mm("home", report))
        self._home_mm = self._rest_mm = self._machine_mm("home", report)

    def _check_homed(self, here_mm: float) -> None:
        """Refuse an axis that homing has not moved: the cycle is compiled for other axes."""
        options, mechanics = self._open_wire.build_options("home"), self._open_mechanics
        forced = options is None or FORCES_ORIGIN in options
        ends_mm = [0.0] if forced else []
        if options is None or not forced:
            ends_mm.append(mechanics.home_mm)
        if min(abs(here_mm - end_mm) for end_mm in ends_mm) > mechanics.tolerance_mm:
            raise DeviceError(
                self.name,
                "home",
                f"homing ended with axis {self._options.axis} at {here_mm:.3f} mm of the machine, not at "
                f"{ends_mm[-1]:.3f} mm: the controller's homing cycle does not home this axis",
                "name another 'axis' in the rig file, or compile GRBL's homing cycle for this one",
            )

    def _move_to(self, mm: float, deadline_s: float) -> None:
        wire, mechanics = self._open_wire, self._open_mechanics
        self._at_rest("move_to")
        target = self._home_mm + mechanics.direction * mm
        self._rest_mm, line = None, f"G90G21G53G0{self._options.axis}{target:.4f}"
        wire.send("move_to", line)
        self._moving = True
        wire.await_ok("move_to", line, ANSWER_S)
        self._await_rest(mm, deadline_s)
        self._moving = False
        report = self._at_rest("move_to")
        stopped_mm = self._machine_mm("move_to", report)
        if abs(stopped_mm - target) > mechanics.tolerance_mm:
            raise DeviceError(
                self.name,
                "move_to",
                f"stopped at {self._stage_mm(stopped_mm):.3f} mm, not at {mm:g} mm",
                OTHER_PROGRAM_REMEDY,
            )
        self._check_switch("move_to", report)
        self._rest_mm = stopped_mm

    def _await_rest(self, mm: float, deadline_s: float) -> None:
        wire = self._open_wire
        wire.send("move_to", AFTER_MOTION)
        while not wire.wait_for_answer("move_to", AFTER_MOTION, POLL_S):
            report = self._status(wire, "move_to")
            if report.state not in ("Run", "Idle"):  # Idle until the motion starts
                raise DeviceError(
                    self.name,
                    "move_to",
                    f"is in state '{report.state}' and does not move",
                    "check its buttons",
                )
            if time.monotonic() >= deadline_s:
                wire.realtime("move_to", HOLD)
                at_mm = self._stage_mm(self._machine_mm("move_to", report))
                raise DeviceTimeoutError(
                    self.name,
                    "move_to",
                    f"is still at {at_mm:.3f} mm on its way to {mm:g} mm",
                    "allow more time",
                )

    def _position_mm(self) -> float:
        report = self._at_rest("position") if self._homed else self._status(self._open_wire, "position")
        return self._stage_mm(self._machine_mm("position", report))

    def _halt(self) -> None:
        self._stop(self._open_wire, "halt")
        self._rest_mm, self._moving = None, False

    def _stop(self, wire: GrblWire, operation: str) -> None:
        """Brake, as a reset in motion loses steps; then reset, which drops planned moves and ends homing."""
        wire.realtime(operation, HOLD)
        braking_s = self._mechanics.braking_s if self._mechanics else 0.0
        deadline = time.monotonic() + braking_s + ANSWER_S
        try:
            while _is_braking(self._status(wire, operation)) and time.monotonic() < deadline:
                time.sleep(POLL_S)
        except DisconnectedError:
            raise
        except DeviceError:
            pass  # no report while homing, or the same alarm again; a reset is executed in either case
        wire.reset(operation, START_S)

    def _status(self, wire: GrblWire, operation: str) -> StatusReport:
        report = wire.status(operation)
        self._offset = report.offset or self._offset
        return report

    def _at_rest(self, operation: str) -> StatusReport:
        """Return the report of a stage at rest where the last move ended, or raise `DeviceError`."""
        report = self._status(self._open_wire, operation)
        if report.state != "Idle":
            raise DeviceError(
                self.name,
                operation,
                f"is in state '{report.state}', not at rest",
                "close, open and home it again",
            )
        machine_mm = self._machine_mm(operation, report)
        if self._rest_mm is not None and abs(machine_mm - self._rest_mm) > self._open_mechanics.rounding_mm:
            expected_mm, here_mm = self._stage_mm(self._rest_mm), self._stage_mm(machine_mm)
            raise DeviceError(
                self.name,
                operation,
                f"was left at {expected_mm:.3f} mm and is at {here_mm:.3f} mm",
                OTHER_PROGRAM_REMEDY,
            )
        return report

    def _check_switch(self, operation: str, report: StatusReport) -> None:
        if self._options.axis in report.pins:
            at_mm = self._stage_mm(self._machine_mm(operation, report))
            raise DeviceError(
                self.name,
                operation,
                f"its home switch is pressed although it should be at {at_mm:.3f} mm: steps were lost",
                "check what blocks it, then close, open and home it again",
            )

    def _machine_mm(self, operation: str, report: StatusReport) -> float:
        """Return the reported position on the machine's axis; the work offset is added to a work position."""
        unit_mm = self._open_mechanics.unit_mm
        if report.machine is not None:
            return report.machine[self._axis] * unit_mm
        for _ in range(REPORTS_PER_OFFSET):
            if report.work is not None and self._offset is not None:
                return (report.work[self._axis] + self._offset[self._axis]) * unit_mm
            report = self._status(self._open_wire, operation)
        raise ProtocolError(self.name, operation, "its reports never contain the work offset", "set $10=1")

    def _stage_mm(self, machine_mm: float) -> float:
        home_mm, direction = self._home_mm, self._open_mechanics.direction
        return machine_mm - home_mm if direction > 0 else home_mm - machine_mm

    @property
    def _open_wire(self) -> GrblWire:
        assert self._wire is not None
        return self._wire

    @property
    def _open_mechanics(self) -> Mechanics:
        assert self._mechanics is not None
        return self._mechanics


def _is_braking(report: StatusReport) -> bool:
    """Tell whether the stage still moves after a feed hold; `Hold:0` is at rest."""
    return report.state in ("Run", "Jog") or (report.state == "Hold" and report.substate == 1)
