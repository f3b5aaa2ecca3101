"""The GRBL controller: lines, real-time commands, states and reports."""

import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from drivers.emulators.grbl.drive import DEFAULTS, Drive, GrblSettings, Rail
from drivers.emulators.grbl.gcode import AxisPositions, GcodeError, Modes, Move, interpret, read_block
from drivers.stage_grbl.lines import AXES
from fpplab.core.units import MM_PER_INCH

VERSION, BUILD = "1.1f", "1.1f.20170801"
RX_BYTES, LINE_CHARACTERS, PLANNED_MOVES = 128, 80, 15
"""Sizes that GRBL is compiled with on an Arduino: receive buffer, longest line, planner's queue."""
WCO_EVERY, OVERRIDES_EVERY = (10, 30), (10, 20)
"""Number of reports from one with this field to the next, at rest and in motion (GRBL's config.h)."""

_COMMENT = re.compile(r"\([^)]*\)?|;.*|\s")


class GrblState(StrEnum):
    """The state that a report begins with."""

    IDLE = "Idle"
    RUN = "Run"
    HOLD = "Hold"
    JOG = "Jog"
    ALARM = "Alarm"
    HOME = "Home"


@dataclass(frozen=True)
class GrblPolicy:
    """Behaviour that depends on GRBL's build, or is known only from its source and logs."""

    locks_at_power_up: bool = True  # HOMING_INIT_LOCK: with homing enabled it starts in the alarm state
    forces_origin: bool = False  # HOMING_FORCE_SET_ORIGIN: the machine position is zero where homing ends
    ok_after_abort: bool = True  # a line that a reset interrupts is still answered `ok`, after the alarm


class GrblController:
    """The controller at the end of a serial line, see `SerialEmulator`."""

    def __init__(
        self,
        clock: Callable[[], float] = time.monotonic,
        settings: dict[int, float] | None = None,
        rail: Rail | None = None,
        policy: GrblPolicy | None = None,
    ) -> None:
        self._clock, self._policy = clock, policy or GrblPolicy()
        self.settings = GrblSettings(DEFAULTS | (settings or {}))
        self.drive = Drive(self.settings, rail or Rail())
        self.alter_line: Callable[[str], str] = lambda line: line
        self._output = bytearray()
        self._advancing = False
        self.power_cycle()

    def receive(self, data: bytes) -> None:
        """Take bytes from the line; real-time commands are executed immediately."""
        for byte in data:
            self._advance()
            match byte:
                case 0x18:
                    self._reset()
                case 0x3F:  # ?
                    self._report()
                case 0x21:  # !
                    self._hold()
                case _ if byte < 0x80 and len(self._waiting) < RX_BYTES - 1:
                    self._waiting.append(byte)
            self._read_lines()

    def poll(self) -> bytes:
        """Advance to the present time and return what there is to send."""
        self._advance()
        self._read_lines()
        output = bytes(self._output)
        self._output.clear()
        return output

    def power_cycle(self) -> None:
        """Switch off and on: the carriage stays where it is, but the position is forgotten."""
        self.drive.forget_position()
        self.modes = Modes()
        locked = self._policy.locks_at_power_up and self.settings.flag(22)
        self.mode = GrblState.ALARM if locked else GrblState.IDLE
        self._start()

    # --- starting and stopping

    def _start(self) -> None:
        self._waiting = bytearray()
        self._awaits_rest = False  # a pause that is answered when all motion has ended
        self._homed_s: float | None = None
        self._is_held = self._needs_reset = False
        self._wco_in = self._overrides_in = 0
        self.modes = Modes(offset=self.modes.offset)  # a reset restores G21 and G90, and keeps G54's offset
        self._send(f"\r\nGrbl {VERSION} ['$' for help]")
        if self.mode is GrblState.ALARM:
            self._send("[MSG:'$H'|'$X' to unlock]")

    def _reset(self) -> None:
        broken_off = self._awaits_rest or self.mode is GrblState.HOME or self._needs_reset
        if self.mode is GrblState.HOME:
            self._alarm(6)
        elif self.drive.motion is not None:
            self._alarm(3)
        self._restart(broken_off)

    def _restart(self, broken_off: bool) -> None:
        if broken_off and self._policy.ok_after_abort:
            self._send("ok")
        if self.mode is not GrblState.ALARM:
            self.mode = GrblState.IDLE
        self._start()

    def _alarm(self, code: int) -> None:
        self.drive.motion = None
        self.mode = GrblState.ALARM
        self._send(f"ALARM:{code}")

    def _lock(self, code: int) -> None:
        """Raise an alarm after which only a reset is obeyed."""
        self._alarm(code)
        self._needs_reset = True
        self._send("[MSG:Reset to continue]")

    # --- motion in time

    def _advance(self) -> None:
        if self._advancing:
            return  # an action at a crossing sends bytes: they arrive while the motion is under way
        self._advancing = True
        try:
            self._advance_to(self._clock())
        finally:
            self._advancing = False

    def _advance_to(self, now: float) -> None:
        if self._homed_s is not None and now >= self._homed_s:
            self._end_homing()
        while motion := self.drive.motion:
            if self.drive.update(now) and self.settings.flag(21):
                self._lock(1)
            if self.drive.motion is not motion or now < motion.ends_s:
                break
            self.drive.motion = None
            self._end_motion()

    def _end_motion(self) -> None:
        if self.mode is GrblState.HOLD:
            self._is_held = True
            return
        self.mode = GrblState.IDLE
        if self._awaits_rest:
            self._awaits_rest = False
            self._send("ok")

    def _begin(self, move: Move, mode: GrblState, rate_mm_s: float = math.inf) -> None:
        self.drive.begin(move, self._clock(), rate_mm_s)
        if self.drive.motion is not None:
            self.mode = mode

    def leave_modes(self, modes: Modes) -> None:
        """Change modes and work offset as another program does; the next report has the offset."""
        self.modes, self._wco_in = modes, 0

    def jog(self, target_mm: float, rate_mm_s: float) -> None:
        """Move the rail's axis to a machine position, as another program does by `$J=`."""
        self._begin(Move(self.drive.axis, target_mm), GrblState.JOG, rate_mm_s)

    def _leaves_travel(self, move: Move) -> bool:
        travel_mm = self.settings.travel_mm(move.axis)
        upwards = self._policy.forces_origin and self.settings.homes_down(move.axis)
        lower_mm, upper_mm = (0.0, travel_mm) if upwards else (-travel_mm, 0.0)
        return self.settings.flag(20) and not lower_mm <= move.target_mm <= upper_mm

    # --- real-time commands

    def _hold(self) -> None:
        """Brake to rest; a jog is cancelled thereby, a move is held until a reset."""
        if self.mode is GrblState.IDLE:
            self.mode, self._is_held = GrblState.HOLD, True
        elif self.mode in (GrblState.RUN, GrblState.JOG):
            if self.mode is GrblState.RUN:
                self.mode = GrblState.HOLD
            self.drive.brake(self._clock())
            if self.drive.motion is None:
                self._end_motion()

    def _report(self) -> None:
        if self._needs_reset or self.mode is GrblState.HOME:
            return
        inches, offset = self.settings.flag(13), self.modes.offset
        in_motion = self.mode in (GrblState.RUN, GrblState.JOG, GrblState.HOLD)
        fields = [f"Hold:{0 if self._is_held else 1}" if self.mode is GrblState.HOLD else str(self.mode)]
        if int(self.settings[10]) & 1:
            fields.append(f"MPos:{_axes(self.drive.position, inches)}")
        else:
            x, y, z = (a - b for a, b in zip(self.drive.position, offset, strict=True))
            fields.append(f"WPos:{_axes((x, y, z), inches)}")
        if int(self.settings[10]) & 2:
            fields.append(f"Bf:{PLANNED_MOVES},{RX_BYTES - len(self._waiting)}")
        speed = self.drive.speed_mm_s(self._clock()) * 60 / (MM_PER_INCH if inches else 1.0)
        fields.append(f"FS:{speed:.0f},0")
        if self.drive.switch_pressed:
            fields.append(f"Pn:{AXES[self.drive.axis]}")
        if self._wco_in == 0:
            self._wco_in = WCO_EVERY[in_motion]
            self._overrides_in = max(self._overrides_in, 1)  # never both in one report
            fields.append(f"WCO:{_axes(offset, inches)}")
        if self._overrides_in == 0:
            self._overrides_in = OVERRIDES_EVERY[in_motion]
            fields.append("Ov:100,100,100")
        self._wco_in -= 1
        self._overrides_in -= 1
        self._send(f"<{'|'.join(fields)}>")

    # --- lines

    def _read_lines(self) -> None:
        while (end := re.search(rb"[\r\n]", self._waiting)) and not self._must_wait(self._waiting[0]):
            line = _COMMENT.sub("", self._waiting[: end.start()].decode("ascii")).upper()
            del self._waiting[: end.end()]
            try:
                self._execute(line)
            except GcodeError as error:
                self._send(f"error:{error.code}")

    def _must_wait(self, first: int) -> bool:
        """Whether a line with this first byte waits in the buffer; real-time commands are done at once."""
        # GRBL would plan further moves while one is under way; here they wait, for the driver sends none.
        if self._needs_reset or self._awaits_rest or self.mode in (GrblState.HOME, GrblState.HOLD):
            return True
        return self.mode is GrblState.RUN and first != ord("$") and not self._waiting.startswith(b"G4")

    def _execute(self, line: str) -> None:
        if len(line) >= LINE_CHARACTERS:
            raise GcodeError(11)
        if line == "$H":
            self._home()
        elif line.startswith("$"):
            self._system(line)
            self._send("ok")
        elif line and self.mode in (GrblState.ALARM, GrblState.JOG):
            raise GcodeError(9)
        else:
            self._gcode(line)

    def _gcode(self, line: str) -> None:
        move = interpret(read_block(line), self.modes, self.drive.position)
        if move is None and self.mode is GrblState.RUN:
            self._awaits_rest = True
            return
        if move is not None and self._leaves_travel(move):
            self._lock(2)
            return
        if move is not None:
            self._begin(move, GrblState.RUN)
        self._send("ok")

    def _system(self, line: str) -> None:
        if self.mode not in (GrblState.IDLE, GrblState.ALARM):
            raise GcodeError(8)
        if line == "$$":
            self._send("\r\n".join(self.settings.report_lines()))
        elif line == "$I":
            self._send(f"[VER:{BUILD}:]")
            self._send(f"[OPT:V{'Z' if self._policy.forces_origin else ''},{PLANNED_MOVES},{RX_BYTES}]")
        else:
            raise GcodeError(3)

    # --- homing

    def _home(self) -> None:
        if self.mode not in (GrblState.IDLE, GrblState.ALARM):
            raise GcodeError(8)
        if not self.settings.flag(22):
            raise GcodeError(5)
        self.mode = GrblState.HOME
        self._homed_s = self._clock() + self.drive.homing_cycle()[0]

    def _end_homing(self) -> None:
        _, carriage_mm, alarm = self.drive.homing_cycle()
        if alarm is not None:
            self.drive.carriage_mm = carriage_mm
            self._alarm(alarm)
            self._restart(broken_off=True)
            return
        self._homed_s, self.mode = None, GrblState.IDLE
        self.drive.finish_homing(carriage_mm, self._policy.forces_origin)
        self._send("ok")

    def _send(self, line: str) -> None:
        self._output += self.alter_line(line + "\r\n").encode("ascii")


def _axes(vector: AxisPositions, inches: bool) -> str:
    return ",".join(f"{mm / MM_PER_INCH:.4f}" if inches else f"{mm:.3f}" for mm in vector)
