"""Requests and their own replies over a USB HID device, as hidapi's `hid.device` drives it.

Every request carries another sequence number than the ones before it, so that a reply which comes late or
twice is told apart and thrown away. Silence, a short report and a set error bit are errors; nothing is sent
twice. That a board echoes number and flags is an assumption (its sibling's guide says so): `checks_echo`
turns the comparison off, and then whatever waits is thrown away before each request.
"""

from __future__ import annotations

from typing import Any, Protocol

from drivers.clock import Clock
from drivers.dlp4500 import framing
from drivers.dlp4500.framing import READ, REPLY_WANTED, Header, UsbMessage
from drivers.dlp4500.protocol import Command, RawBytes, RegisterLayout, Values
from fpplab.core.errors import DeviceError, DeviceTimeoutError, DisconnectedError, ProtocolError, SettingError

VENDOR, PRODUCT = 0x0451, 0x6401
INTERFACE = 0
"""Of several HID interfaces the one that takes commands."""
TIMEOUT_S = 2.0
"""As long as the maker's client waits for a reply."""
MOST_STALE = 64
"""Reports thrown away before the device is said to talk nonsense."""


class HidDevice(Protocol):
    """An open HID device: hidapi's `hid.device`."""

    def write(self, buff: bytes) -> int:
        """Send a report number and a report; -1 when that fails."""

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        """The next report, or nothing after the time-out; `OSError` when the device is gone."""

    def close(self) -> None:
        """Let go."""


class HidModule(Protocol):
    """What is used of the module `hid`."""

    def enumerate(self, vendor_id: int, product_id: int) -> list[dict[str, Any]]:
        """The interfaces that are plugged in."""

    def device(self) -> Any:
        """A `HidDevice` with `open_path`, not open yet."""


def load_hidapi(name: str) -> HidModule:
    """The library that talks to USB. Raises `DeviceError` when it does not load."""
    try:
        import hid
    except ImportError as error:
        raise DeviceError(
            name, "open", f"hidapi does not load ({error})", "install the package libusb-1.0-0"
        ) from error
    found: HidModule = hid
    return found


def connect(hid: HidModule, name: str, serial: str | None) -> tuple[HidDevice, str]:
    """Open the one LightCrafter 4500 of that serial number, or the only one without; and that number.

    Raises `DisconnectedError` when it is not there, `DeviceError` when there are several or it does not open.
    """
    found = [
        (d["path"], d["serial_number"] or "")
        for d in hid.enumerate(VENDOR, PRODUCT)
        if d["interface_number"] in (-1, INTERFACE) and serial in (None, d["serial_number"])
    ]
    if not found:
        wanted = f" with serial number {serial}" if serial is not None else ""
        raise DisconnectedError(
            name, "open", f"no LightCrafter 4500{wanted} is connected", "see its power and USB cable"
        )
    if len(found) > 1:
        raise DeviceError(
            name,
            "open",
            f"{len(found)} LightCrafters 4500 are connected",
            f"name one of {sorted(number for _, number in found)} as 'serial' in the rig file",
        )
    wire = hid.device()
    try:
        wire.open_path(found[0][0])
    except OSError as error:
        raise DeviceError(
            name,
            "open",
            f"the USB device cannot be opened ({error})",
            "end what else uses it",
        ) from error
    return wire, found[0][1]


class Link:
    """One conversation with the controller.

    name: the device's, for its errors. requests: how many have been sent.
    """

    def __init__(
        self, wire: HidDevice, clock: Clock, name: str, checks_echo: bool = True, timeout_s: float = TIMEOUT_S
    ) -> None:
        self._wire, self._clock, self.name = wire, clock, name
        self._checks_echo, self._timeout_s = checks_echo, timeout_s
        self.requests = 0

    def close(self) -> None:
        """Let go of the device."""
        self._wire.close()

    def write(self, command: Command, **values: int) -> None:
        """Order something by a command of fields.

        Raises `SettingError` for a value out of range, before anything is sent; `ProtocolError` when the
        device refuses, `DeviceTimeoutError` when it does not answer, `DisconnectedError` when it is gone.
        """
        self._write(command, self._packed(command, command.written, values))

    def write_bytes(self, command: Command, data: bytes) -> None:
        """Order something by a command of bytes; errors as `write`."""
        assert isinstance(command.written, RawBytes)
        try:
            command.written.check(data)
        except ValueError as error:
            raise SettingError(self.name, command.name, str(error)) from error
        self._write(command, data)

    def read(self, command: Command, **selector: int) -> Values:
        """Ask for the fields of a command; errors as `write`, and `ProtocolError` for impossible values."""
        data = self._query(command, selector)
        try:
            assert isinstance(command.returned, RegisterLayout)
            return command.returned.unpack(data)
        except ValueError as error:
            raise self._protocol_error(command.name, str(error)) from error

    def read_bytes(self, command: Command, **selector: int) -> bytes:
        """Ask for the bytes of a command; errors as `read`."""
        data = self._query(command, selector)
        try:
            assert isinstance(command.returned, RawBytes)
            command.returned.check(data)
        except ValueError as error:
            raise self._protocol_error(command.name, str(error)) from error
        return data

    def drain(self) -> None:
        """Throw away whatever waits to be read."""
        for _ in range(MOST_STALE):
            if not self._report("drain", 1):
                return
        raise self._protocol_error("drain", "reports keep coming that nobody asked for")

    def _write(self, command: Command, data: bytes) -> None:
        self._exchange(command, data, REPLY_WANTED if command.acknowledged else 0)

    def _query(self, command: Command, selector: Values) -> bytes:
        data = self._packed(command, command.selector, selector)
        reply = self._exchange(command, data, READ | REPLY_WANTED)
        assert reply is not None
        if not reply.payload:
            raise self._protocol_error(command.name, "an empty answer")
        return reply.payload

    def _packed(self, command: Command, layout: RegisterLayout | RawBytes | None, values: Values) -> bytes:
        assert isinstance(layout, RegisterLayout)
        try:
            return layout.pack(values)
        except ValueError as error:
            raise SettingError(self.name, command.name, str(error)) from error

    def _exchange(self, command: Command, data: bytes, flags: int) -> UsbMessage | None:
        if not self._checks_echo:
            self.drain()
        sequence = self.requests % 256
        self.requests += 1
        for report in framing.make_request(command.number, data, sequence, flags).reports():
            self._send(command.name, report)
        if not flags & REPLY_WANTED:
            return None
        reply = self._reply(command.name, flags, sequence)
        if reply.failed:
            raise ProtocolError(
                self.name, command.name, "the projector refuses it", "see 'fpplab dlp4500 status'"
            )
        return reply

    def _send(self, operation: str, report: bytes) -> None:
        try:
            sent = self._wire.write(b"\0" + report)
        except OSError as error:
            raise self._disconnected(operation) from error
        if sent < 0:
            raise self._disconnected(operation)

    def _reply(self, operation: str, flags: int, sequence: int) -> UsbMessage:
        deadline = self._clock.now() + self._timeout_s
        for _ in range(MOST_STALE):
            report = self._next_report(operation, deadline)
            try:
                head = framing.parse_header(report)
                message = self._complete_reply(operation, head, report, deadline)
            except ValueError as error:
                raise self._protocol_error(operation, str(error)) from error
            if self._answers(head, flags, sequence):
                return message
        raise self._protocol_error(operation, "answers to questions that were not asked")

    def _answers(self, head: Header, flags: int, sequence: int) -> bool:
        if not self._checks_echo:
            return True
        return head.sequence == sequence and head.flags & ~framing.ERROR == flags

    def _complete_reply(self, operation: str, head: Header, first: bytes, deadline: float) -> UsbMessage:
        """The answer that `first` begins; acknowledgements and refusals are one report, whatever they say."""
        if not head.flags & READ or head.flags & framing.ERROR:
            return UsbMessage(head.flags, head.sequence)
        rest = [
            self._next_report(operation, deadline) for _ in range(framing.continuation_reports(head.length))
        ]
        return framing.join_reports([first, *rest])

    def _next_report(self, operation: str, deadline: float) -> bytes:
        """The next report before the deadline."""
        left_ms = max(1, round(1e3 * (deadline - self._clock.now())))  # 0 would wait for ever
        report = self._report(operation, left_ms)
        if not report:
            raise DeviceTimeoutError(
                self.name,
                operation,
                f"no complete answer within {self._timeout_s:g} s",
                "see the USB cable; switch the projector off and on",
            )
        return report

    def _report(self, operation: str, timeout_ms: int) -> bytes:
        try:
            return bytes(self._wire.read(framing.REPORT_BYTES, timeout_ms))
        except OSError as error:
            raise self._disconnected(operation) from error

    def _disconnected(self, operation: str) -> DisconnectedError:
        return DisconnectedError(
            self.name, operation, "the USB device is gone", "see its power and cable, and open it again"
        )

    def _protocol_error(self, operation: str, found: str) -> ProtocolError:
        return ProtocolError(self.name, operation, found, "switch the projector off and on")
