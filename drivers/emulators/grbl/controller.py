"""The GRBL controller: lines, real-time commands, states and reports."""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from drivers.emulators.grbl.drive import Drive, Rail
from drivers.emulators.grbl.gcode import (
    AXES,
    MM_PER_INCH,
    ORIGIN,
    AxisPositions,
    Dwell,
    GcodeError,
    Interpreter,
    Move,
)
from drivers.emulators.grbl.settings import DEFAULTS, GrblSettings

VERSION, BUILD = "1.1f", "1.1f.20170801"
RX_BYTES, LINE_CHARACTERS, PLANNED_MOVES = 128, 80, 15
"""Size of the receive buffer in bytes, longest line in characters, size of the planner's queue in moves."""
WCO_EVERY, OVERRIDES_EVERY = (10, 30), (10, 20)
"""Number of reports from one with this field to the next, at rest and in motion."""

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
    """What depends on GRBL's build, or is known from its source and logs alone."""

    locks_at_power_up: bool = True  # HOMING_INIT_LOCK: with homing enabled it starts in the alarm state
    forces_origin: bool = False  # HOMING_FORCE_SET_ORIGIN: the machine position is zero where homing ends
    ok_after_abort: bool = True  # A line that a reset breaks off is still answered `ok`, after the alarm


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
        self.power_cycle()

    def receive(self, data: bytes) -> None:
        """Take bytes from the line; real-time commands are obeyed at once."""
        for byte in data:
            self._advance()
            match byte:
                case 0x18:
                    self._reset()
                case 0x3F:  # ?
                    self._report()
                case 0x21:  # !
                    self._hold()
                case 0x7E:  # ~
                    self._resume()
                case 0x85:
                    self._cancel_jog()
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

    @property
    def mode(self) -> GrblState:
        """The state that a report would give."""
        return self._mode

    def power_cycle(self) -> None:
        """Switch off and on: the carriage stays where it is, but the position is forgotten."""
        self.drive.forget_position()
        self._program = Interpreter()
        locked = self._policy.locks_at_power_up and self.settings.flag(22)
        self._mode = GrblState.ALARM if locked else GrblState.IDLE
        self._start()

    # --- starting and stopping

    def _start(self) -> None:
        self._waiting = bytearray()
        self._queue: deque[Move] = deque()
        self._dwell: Dwell | None = None
        self._rested_s = 0.0
        self._homed_s: float | None = None
        self._holding = self._needs_reset = False
        self._wco_in = self._overrides_in = 0
        self._program.reset()
        self._send(f"\r\nGrbl {VERSION} ['$' for help]")
        if self._mode is GrblState.ALARM:
            self._send("[MSG:'$H'|'$X' to unlock]")

    def _reset(self) -> None:
        broken_off = self._dwell is not None or self._mode is GrblState.HOME or self._needs_reset
        if self._mode is GrblState.HOME:
            self._alarm(6)
        elif self.drive.motion is not None:
            self._alarm(3)
        self._restart(broken_off)

    def _restart(self, broken_off: bool) -> None:
        if broken_off and self._policy.ok_after_abort:
            self._send("ok")
        if self._mode is not GrblState.ALARM:
            self._mode = GrblState.IDLE
        self._start()

    def _alarm(self, code: int) -> None:
        self.drive.motion = None
        self._queue.clear()
        self._mode = GrblState.ALARM
        self._send(f"ALARM:{code}")

    def _lock(self, code: int) -> None:
        """Raise an alarm after which only a reset is obeyed."""
        self._alarm(code)
        self._needs_reset = True
        self._send("[MSG:Reset to continue]")

    # --- motion in time

    def _advance(self) -> None:
        now = self._clock()
        if self._homed_s is not None and now >= self._homed_s:
            self._end_homing()
        while motion := self.drive.motion:
            if self.drive.update(now) and self.settings.flag(21):
                self._lock(1)
            if self.drive.motion is not motion or now < motion.ends_s:
                break
            self.drive.motion = None
            self._start_next_move(motion.ends_s)
        self._end_dwell(now)

    def _start_next_move(self, at_s: float) -> None:
        """Start the next planned move when a motion has ended; without one come to rest."""
        if self._mode is GrblState.HOLD:
            self._holding = True
            return
        while self._queue and self.drive.motion is None:
            self.drive.begin(self._queue.popleft(), at_s)
        if self.drive.motion is None:
            self._mode, self._rested_s = GrblState.IDLE, at_s

    def _end_dwell(self, now: float) -> None:
        if self._dwell and self._mode is GrblState.IDLE and now >= self._rested_s + self._dwell.seconds:
            self._dwell = None
            self._send("ok")

    def _plan(self, move: Move, mode: GrblState) -> None:
        self._queue.append(move)
        if self._mode is GrblState.IDLE:
            self._mode = mode
            self._start_next_move(self._clock())

    @property
    def _planned_end(self) -> AxisPositions:
        if self._queue:
            return self._queue[-1].target
        return self.drive.motion.target if self.drive.motion else self.drive.position

    def _leaves_travel(self, target: AxisPositions) -> bool:
        for i, mm in enumerate(target):
            travel = self.settings.travel_mm(i)
            upwards = self._policy.forces_origin and self.settings.homes_down(i)
            least, most = (0.0, travel) if upwards else (-travel, 0.0)
            if self.settings.flag(20) and not least <= mm <= most:
                return True
        return False

    # --- real-time commands

    def _hold(self) -> None:
        if self._mode is GrblState.IDLE:
            self._mode, self._holding = GrblState.HOLD, True
        elif self._mode is GrblState.RUN:
            self._mode = GrblState.HOLD
            rest = self.drive.brake(self._clock())
            if rest:
                self._queue.appendleft(rest)
            if self.drive.motion is None:
                self._start_next_move(self._clock())
        else:
            self._cancel_jog()

    def _cancel_jog(self) -> None:
        if self._mode is GrblState.JOG:
            self._queue.clear()
            self.drive.brake(self._clock())
            if self.drive.motion is None:
                self._start_next_move(self._clock())

    def _resume(self) -> None:
        if self._holding:
            self._holding, self._mode = False, GrblState.RUN
            self._start_next_move(self._clock())

    def _report(self) -> None:
        if self._needs_reset or self._mode is GrblState.HOME:
            return
        inches, offset = self.settings.flag(13), self._program.offset
        in_motion = self._mode in (GrblState.RUN, GrblState.JOG, GrblState.HOLD)
        fields = [f"Hold:{0 if self._holding else 1}" if self._mode is GrblState.HOLD else str(self._mode)]
        if int(self.settings[10]) & 1:
            fields.append(f"MPos:{_axes(self.drive.position, inches)}")
        else:
            x, y, z = (a - b for a, b in zip(self.drive.position, offset, strict=True))
            fields.append(f"WPos:{_axes((x, y, z), inches)}")
        if int(self.settings[10]) & 2:
            fields.append(f"Bf:{PLANNED_MOVES - len(self._queue)},{RX_BYTES - len(self._waiting)}")
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
        while not self._defers_lines and (end := re.search(rb"[\r\n]", self._waiting)):
            line = _COMMENT.sub("", self._waiting[: end.start()].decode("ascii")).upper()
            del self._waiting[: end.end()]
            try:
                self._execute(line)
            except GcodeError as error:
                self._send(f"error:{error.code}")

    @property
    def _defers_lines(self) -> bool:
        """Whether lines wait in the buffer; real-time commands are obeyed all the same."""
        full = len(self._queue) >= PLANNED_MOVES
        return (
            full
            or self._needs_reset
            or self._dwell is not None
            or self._mode in (GrblState.HOME, GrblState.HOLD)
        )

    def _execute(self, line: str) -> None:
        if len(line) >= LINE_CHARACTERS:
            raise GcodeError(11)
        if line.startswith("$J="):
            self._jog(line.removeprefix("$J="))
        elif line == "$H":
            self._home()
        elif line.startswith("$"):
            self._system(line)
            self._send("ok")
        elif line and self._mode in (GrblState.ALARM, GrblState.JOG):
            raise GcodeError(9)
        else:
            self._gcode(line)

    def _gcode(self, line: str) -> None:
        offset = self._program.offset
        asked = self._program.execute(line, self._planned_end)
        if self._program.offset != offset:
            self._wco_in = 0
        if isinstance(asked, Dwell):
            self._dwell, self._rested_s = asked, self._clock()
            self._end_dwell(self._clock())
            return
        if isinstance(asked, Move):
            if self._leaves_travel(asked.target):
                self._lock(2)
                return
            self._plan(asked, GrblState.RUN)
        self._send("ok")

    def _jog(self, line: str) -> None:
        if self._mode not in (GrblState.IDLE, GrblState.JOG):
            raise GcodeError(8)
        asked = self._program.jog(line, self._planned_end)
        if self._leaves_travel(asked.target):
            raise GcodeError(15)
        self._plan(asked, GrblState.JOG)
        self._send("ok")

    def _system(self, line: str) -> None:
        if line == "$$":
            if self._mode is GrblState.RUN:
                raise GcodeError(8)
            self._send("\r\n".join(self.settings.report_lines()))
        elif line == "$G":
            self._send(self._program.modes())
        elif line == "$":
            self._send("[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]")
        elif line == "$X":
            if self._mode is GrblState.ALARM:
                self._mode = GrblState.IDLE
                self._send("[MSG:Caution: Unlocked]")
        elif self._mode not in (GrblState.IDLE, GrblState.ALARM):
            raise GcodeError(8)
        elif line == "$#":
            self._send_offsets()
        elif line == "$I":
            self._send(f"[VER:{BUILD}:]")
            self._send(f"[OPT:V{'Z' if self._policy.forces_origin else ''},{PLANNED_MOVES},{RX_BYTES}]")
        elif line == "$N":
            self._send("$N0=\r\n$N1=")
        else:
            self.settings.assign(line)
            self._wco_in = 0

    def _send_offsets(self) -> None:
        inches = self.settings.flag(13)
        named = [(f"G{54 + i}", system) for i, system in enumerate(self._program.systems)]
        for name, vector in [*named, ("G28", ORIGIN), ("G30", ORIGIN), ("G92", self._program.shift)]:
            self._send(f"[{name}:{_axes(vector, inches)}]")
        self._send(f"[TLO:{_axes(ORIGIN, inches).split(',')[0]}]")
        self._send(f"[PRB:{_axes(ORIGIN, inches)}:0]")

    # --- homing

    def _home(self) -> None:
        if self._mode not in (GrblState.IDLE, GrblState.ALARM):
            raise GcodeError(8)
        if not self.settings.flag(22):
            raise GcodeError(5)
        self._mode = GrblState.HOME
        self._homed_s = self._clock() + self.drive.homing_cycle()[0]

    def _end_homing(self) -> None:
        _, carriage_mm, alarm = self.drive.homing_cycle()
        if alarm is not None:
            self.drive.carriage_mm = carriage_mm
            self._alarm(alarm)
            self._restart(broken_off=True)
            return
        self._homed_s, self._mode = None, GrblState.IDLE
        self.drive.set_home(carriage_mm, self._policy.forces_origin)
        self._send("ok")

    def _send(self, line: str) -> None:
        self._output += self.alter_line(line + "\r\n").encode("ascii")


def _axes(vector: AxisPositions, inches: bool) -> str:
    return ",".join(f"{mm / MM_PER_INCH:.4f}" if inches else f"{mm:.3f}" for mm in vector)
