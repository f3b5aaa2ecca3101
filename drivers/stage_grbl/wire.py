"""The serial line to a GRBL controller: what is sent, and which answer belongs to it.

One line is under way at a time and is waited for, so that GRBL's 128 bytes of buffer never overflow and an
answer cannot be taken for another's. Silence is never success, and what is not GRBL's is never ignored.
"""

from __future__ import annotations

import time
from collections import deque

import serial

from drivers.stage_grbl.lines import (
    RESET,
    STATUS,
    Alarm,
    GrblError,
    GrblMessage,
    Ok,
    Setting,
    StatusReport,
    Welcome,
    describe_alarm,
    describe_error,
    parse_line,
)
from fpplab.core.errors import DeviceError, DeviceTimeoutError, DisconnectedError, ProtocolError

BAUD = 115200
START_S = 5.0
"""For a board that restarts when its port is opened, as an Arduino does, boot loader and all."""
ANSWER_S = 2.0
"""GRBL reports within 20 ms, but pauses for 0.5 s after an alarm, and while it stores a setting."""
LONGEST_LINE = 256


class RestartedError(DeviceError):
    """The controller has welcomed us unasked: it was reset or switched off, and counts from anew."""


class GrblWire:
    """An open port. name: the device's, for errors; `operation` is what the device is at, likewise."""

    def __init__(self, name: str, port: str) -> None:
        """Raises `DeviceError` when the port cannot be opened, or another program holds it."""
        self._name, self._port = name, port
        self._received = bytearray()
        self._answers: deque[Ok | GrblError] = deque()
        self._report: StatusReport | None = None
        self._settings: dict[int, float] = {}
        try:
            self._serial = serial.Serial(port, BAUD, timeout=0, write_timeout=ANSWER_S, exclusive=True)
        except (OSError, ValueError) as error:
            raise _not_opened(name, port, error) from error

    def close(self) -> None:
        """Let go of the port; legal any number of times."""
        self._serial.close()

    def reset(self, operation: str, timeout_s: float) -> str:
        """Stop and restart the controller; what it said before is dropped. Returns its version."""
        self._read(operation, time.monotonic())
        self._received.clear()  # or a welcome from before would be taken for the answer
        self._write(operation, RESET)
        deadline = time.monotonic() + timeout_s
        while (line := self._line(operation, deadline)) is not None:
            try:
                message = parse_line(line)
            except ValueError:
                continue  # half a line from before the reset
            if isinstance(message, Welcome):
                self._answers.clear()
                self._settings.clear()
                return message.version
        raise DeviceTimeoutError(
            self._name,
            operation,
            f"no GRBL answers at {self._port} within {timeout_s:g} s",
            "see to power and cable, and that this is the stage's port (`fpplab devices`)",
        )

    def await_ok(self, operation: str, line: str, timeout_s: float) -> None:
        """Wait for the `ok` to the line sent."""
        if not self.wait_for_answer(operation, line, timeout_s):
            raise DeviceTimeoutError(
                self._name,
                operation,
                f"no answer to '{line}' within {timeout_s:g} s",
                "see to power and cable",
            )

    def send(self, operation: str, line: str) -> None:
        """Send one line; `answered` waits for its answer. Whatever came unasked comes to light before."""
        while self._process_line(operation, time.monotonic()):
            pass
        if self._answers:
            raise ProtocolError(
                self._name,
                operation,
                f"{self._port} answered what was not asked",
                "another program uses the port as well: close it",
            )
        self._write(operation, line.encode("ascii") + b"\n")

    def wait_for_answer(self, operation: str, line: str, within_s: float) -> bool:
        """Whether the answer to the line sent has come; raise `DeviceError` if it was refused."""
        deadline = time.monotonic() + within_s
        while not self._answers:
            if not self._process_line(operation, deadline):
                return False
        answer = self._answers.popleft()
        if isinstance(answer, GrblError):
            raise DeviceError(self._name, operation, f"refused '{line}': {describe_error(answer.code)}")
        return True

    def status(self, operation: str) -> StatusReport:
        """What the controller does, and where it is. It does not tell during homing."""
        self._report = None
        self._write(operation, STATUS)
        deadline = time.monotonic() + ANSWER_S
        while self._report is None:
            if not self._process_line(operation, deadline):
                raise DeviceTimeoutError(
                    self._name, operation, f"no report within {ANSWER_S:g} s", "see to power and cable"
                )
        return self._report

    def settings(self, operation: str) -> dict[int, float]:
        """All of `$$`, by number."""
        self._settings.clear()
        self.send(operation, "$$")
        self.await_ok(operation, "$$", ANSWER_S)
        return dict(self._settings)

    def realtime(self, operation: str, byte: bytes) -> None:
        """Send a command that is obeyed at once, and has no answer."""
        self._write(operation, byte)

    def _process_line(self, operation: str, deadline: float) -> bool:
        """Take one line to where it belongs; False when none came in time."""
        line = self._line(operation, deadline)
        if line is None:
            return False
        try:
            message = parse_line(line)
        except ValueError as error:
            raise ProtocolError(
                self._name,
                operation,
                str(error),
                "see to the cable, and close other programs that use the port",
            ) from None
        self._dispatch(operation, message)
        return True

    def _dispatch(self, operation: str, message: GrblMessage) -> None:
        match message:
            case Ok() | GrblError():
                self._answers.append(message)
            case StatusReport():
                self._report = message
            case Setting(number, value):
                self._settings[number] = value
            case Alarm(code):
                raise DeviceError(
                    self._name,
                    operation,
                    describe_alarm(code),
                    "see that the way is free, then close, open and home it again",
                )
            case Welcome():
                raise RestartedError(
                    self._name,
                    operation,
                    "the controller has restarted, and where the stage stands is lost",
                    "see to its supply, then close, open and home it again",
                )

    def _line(self, operation: str, deadline: float) -> str | None:
        """The next line that is not empty; None when none is complete in time."""
        while True:
            while (end := self._received.find(b"\n")) >= 0:
                line = self._received[:end].decode("ascii", "backslashreplace").strip("\r")
                del self._received[: end + 1]
                if line:
                    return line
            if len(self._received) > LONGEST_LINE:
                beginning = bytes(self._received[:20])
                self._received.clear()
                raise ProtocolError(
                    self._name, operation, f"{beginning!r} … has no end", f"set the controller to {BAUD} baud"
                )
            if not self._read(operation, deadline):
                return None

    def _read(self, operation: str, deadline: float) -> bool:
        """Wait for bytes; False at the deadline. Bytes that are there are read even after it."""
        try:
            self._serial.timeout = max(0.0, deadline - time.monotonic())
            data = self._serial.read(1)
            data += self._serial.read(self._serial.in_waiting) if data else b""
        except OSError as error:
            raise self._disconnected(operation) from error
        self._received += data
        return bool(data)

    def _write(self, operation: str, data: bytes) -> None:
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            raise DeviceTimeoutError(
                self._name, operation, f"{self._port} takes nothing more", "see to the cable"
            ) from None
        except OSError as error:
            raise self._disconnected(operation) from error

    def _disconnected(self, operation: str) -> DisconnectedError:
        return DisconnectedError(
            self._name,
            operation,
            f"{self._port} is gone",
            "see to the cable and the stage's supply, then open it again",
        )


def _not_opened(name: str, port: str, error: Exception) -> DeviceError:
    reason = str(error).lower()
    if "permission denied" in reason or "access is denied" in reason:
        return DeviceError(
            name, "open", f"{port} may not be used", "see `fpplab devices` for what is missing"
        )
    if "lock" in reason or "busy" in reason:
        return DeviceError(name, "open", f"{port} is in use", "close the other program that holds it")
    if "no such file" in reason or "cannot find" in reason:
        return DisconnectedError(
            name, "open", f"there is no {port}", "plug it in; `fpplab devices` lists the ports"
        )
    return DeviceError(name, "open", f"{port} cannot be opened ({error})", "see that it is a serial port")
