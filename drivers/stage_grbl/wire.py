"""The serial connection to a GRBL controller: sending lines, and matching answers to them.

Only one line is sent at a time and its answer is awaited, so that GRBL's receive buffer of 128 bytes cannot
overflow and an answer cannot be taken for that of another line. A missing answer is an error, and so is
anything that is not part of GRBL's protocol.
"""

import logging
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
    OtherLine,
    Setting,
    StatusReport,
    Welcome,
    describe_alarm,
    describe_error,
    parse_line,
)
from fpplab.core.errors import DeviceError, DeviceTimeoutError, DisconnectedError, ProtocolError
from fpplab.core.logs import log_traffic

_log = logging.getLogger(__name__)

BAUD = 115200  # GRBL 1.1's baud rate (config.h)
START_S = 5.0
"""Longest wait in s for the welcome message (chosen); an Arduino restarts when its port is opened."""
ANSWER_S = 2.0
"""Longest wait in s for an answer (chosen).

GRBL reports within 20 ms, but pauses for 0.5 s after an alarm and while it stores a setting.
"""
BUILD_INFO, BUILD_OPTIONS = "$I", "[OPT:"
"""Command for the build's version and options, and the beginning of the line that names the options."""
MAX_LINE_BYTES = 256  # bytes without a line end at which the input is taken to be noise (chosen)


class RestartedError(DeviceError):
    """The controller restarted unexpectedly, by a reset or a power failure, and its position is lost."""


class GrblWire:
    """An open serial port with a GRBL controller.

    Every method takes the operation that the device is carrying out, for errors. Each may raise
    `DisconnectedError` when the port is gone; those that receive raise `DeviceError` for an alarm,
    `RestartedError` for an unexpected restart and `ProtocolError` for a line that is not GRBL's.
    """

    def __init__(self, name: str, port: str) -> None:
        """Open the port, or raise `DeviceError` when it cannot be opened or another program uses it."""
        self._name, self._port = name, port
        self._received = bytearray()
        self._answers: deque[Ok | GrblError] = deque()
        self._report: StatusReport | None = None
        self._settings: dict[int, float] = {}
        self._build_options: str | None = None
        try:
            self._serial = serial.serial_for_url(
                port, BAUD, timeout=0, write_timeout=ANSWER_S, exclusive=True
            )
        except (OSError, ValueError) as error:
            raise _not_opened(name, port, error) from error

    def close(self) -> None:
        """Close the port; may be called any number of times."""
        self._serial.close()

    def reset(self, operation: str, timeout_s: float) -> str:
        """Restart the controller, which stops it at once, and discard what it sent before."""
        version = self._welcomed(operation, timeout_s)
        tried = ""
        if version is None and self._release_control_lines():
            version, tried = self._welcomed(operation, timeout_s), ", nor with DTR and RTS off"
        if version is None:
            raise DeviceTimeoutError(
                self._name,
                operation,
                f"no GRBL controller answers at {self._port} within {timeout_s:g} s{tried}",
                "check power and cable, and that this is the stage's port (`fpplab devices`)",
            )
        return version

    def _release_control_lines(self) -> bool:
        """Switch DTR and RTS off, which hold some boards in reset; False at a port without such lines."""
        try:
            self._serial.dtr = self._serial.rts = False
        except OSError:
            return False
        _log.info("%s: no answer at %s: DTR and RTS are switched off", self._name, self._port)
        return True

    def _welcomed(self, operation: str, timeout_s: float) -> str | None:
        """Order a reset, and return the version of the welcome message; None where none comes."""
        self._wait_for_bytes(operation, time.monotonic())
        self._received.clear()  # an earlier welcome message must not be taken for the answer
        self._write(operation, RESET)
        deadline = time.monotonic() + timeout_s
        while (line := self._line(operation, deadline)) is not None:
            try:
                message = parse_line(line)
            except ValueError:
                continue  # a partial line from before the reset
            if isinstance(message, Welcome):
                self._answers.clear()
                self._settings.clear()
                return message.version
        return None

    def await_ok(self, operation: str, line: str, timeout_s: float) -> None:
        if not self.wait_for_answer(operation, line, timeout_s):
            raise DeviceTimeoutError(
                self._name,
                operation,
                f"no answer to '{line}' within {timeout_s:g} s",
                "check power and cable",
            )

    def send(self, operation: str, line: str) -> None:
        """Send one line; `wait_for_answer` or `await_ok` must be called for its answer."""
        # Messages that have arrived in the meantime are processed before, so that an alarm or a restart is
        # noticed.
        while self._process_line(operation, time.monotonic()):
            pass
        if self._answers:
            raise ProtocolError(
                self._name,
                operation,
                f"{self._port} sent an answer to a command that was not sent",
                "another program uses the port as well: close it",
            )
        self._write(operation, line.encode("ascii") + b"\n")

    def wait_for_answer(self, operation: str, line: str, timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        while not self._answers:
            if not self._process_line(operation, deadline):
                return False
        answer = self._answers.popleft()
        if isinstance(answer, GrblError):
            raise DeviceError(self._name, operation, f"refused '{line}': {describe_error(answer.code)}")
        return True

    def status(self, operation: str) -> StatusReport:
        """Query state and position; the controller does not answer while it homes."""
        self._report = None
        self._write(operation, STATUS)
        deadline = time.monotonic() + ANSWER_S
        while self._report is None:
            if not self._process_line(operation, deadline):
                raise DeviceTimeoutError(
                    self._name, operation, f"no report within {ANSWER_S:g} s", "check power and cable"
                )
        return self._report

    def settings(self, operation: str) -> dict[int, float]:
        """Read all settings (`$$`)."""
        self._settings.clear()
        self.send(operation, "$$")
        self.await_ok(operation, "$$", ANSWER_S)
        return dict(self._settings)

    def build_options(self, operation: str) -> str | None:
        """Read the letters of the options that the controller was compiled with (`$I`)."""
        self._build_options = None
        self.send(operation, BUILD_INFO)
        self.await_ok(operation, BUILD_INFO, ANSWER_S)
        return self._build_options

    def realtime(self, operation: str, byte: bytes) -> None:
        """Send a real-time command, which is executed at once and has no answer."""
        self._write(operation, byte)

    def _process_line(self, operation: str, deadline: float) -> bool:
        """Process one line; return False when none came in time."""
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
                "check the cable, and close other programs that use the port",
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
            case OtherLine(text) if text.startswith(BUILD_OPTIONS):
                self._build_options = text.removeprefix(BUILD_OPTIONS).rstrip("]").split(",")[0]
            case Alarm(code):
                raise DeviceError(
                    self._name,
                    operation,
                    describe_alarm(code),
                    "check that the way is free, then close, open and home it again",
                )
            case Welcome():
                raise RestartedError(
                    self._name,
                    operation,
                    "the controller has restarted, and the stage's position is lost",
                    "check its power supply, then close, open and home it again",
                )

    def _line(self, operation: str, deadline: float) -> str | None:
        """Return the next line that is not empty, or None when none is complete in time."""
        while True:
            while (end := self._received.find(b"\n")) >= 0:
                line = self._received[:end].decode("ascii", "backslashreplace").strip("\r")
                del self._received[: end + 1]
                if line:
                    log_traffic(self._name, "from", line)
                    return line
            if len(self._received) > MAX_LINE_BYTES:
                beginning = bytes(self._received[:20])
                self._received.clear()
                raise ProtocolError(
                    self._name,
                    operation,
                    f"{beginning!r} … has no line end",
                    f"set the controller to {BAUD} baud",
                )
            if not self._wait_for_bytes(operation, deadline):
                return None

    def _wait_for_bytes(self, operation: str, deadline: float) -> bool:
        """Wait for bytes and return False at the deadline; bytes that have arrived are read even after it."""
        try:
            self._serial.timeout = max(0.0, deadline - time.monotonic())
            data = self._serial.read(1)
            data += self._serial.read(self._serial.in_waiting) if data else b""
        except OSError as error:
            raise self._disconnected(operation) from error
        self._received += data
        return bool(data)

    def _write(self, operation: str, data: bytes) -> None:
        log_traffic(self._name, "to", data.decode("ascii", "backslashreplace").strip())
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            raise DeviceTimeoutError(
                self._name, operation, f"{self._port} accepts no more data", "check the cable"
            ) from None
        except OSError as error:
            raise self._disconnected(operation) from error

    def _disconnected(self, operation: str) -> DisconnectedError:
        return DisconnectedError(
            self._name,
            operation,
            f"{self._port} is gone",
            "check the cable and the stage's power supply, then open it again",
        )


def _not_opened(name: str, port: str, error: Exception) -> DeviceError:
    reason = str(error).lower()
    if "permission denied" in reason or "access is denied" in reason:
        return DeviceError(
            name, "open", f"no permission to use {port}", "see `fpplab devices` for what is missing"
        )
    if "lock" in reason or "busy" in reason:
        return DeviceError(name, "open", f"{port} is in use", "close the other program that holds it")
    if "no such file" in reason or "cannot find" in reason:
        return DisconnectedError(
            name, "open", f"there is no {port}", "plug it in; `fpplab devices` lists the ports"
        )
    return DeviceError(name, "open", f"{port} cannot be opened ({error})", "check that it is a serial port")
