"""Requests and their replies over a USB HID device, through hidapi's `hid.device`.

Consecutive requests carry different sequence numbers, so that a late or duplicate reply is recognised and
discarded. A missing reply, a short report and a set error bit are errors; nothing is sent twice. That a board
echoes sequence number and flags is an assumption, supported by the guide of its sibling: `checks_echo=False`
disables the comparison, and then all waiting reports are discarded before each request.
"""

from typing import Any, Protocol

from drivers.clock import Clock
from drivers.dlp4500 import framing
from drivers.dlp4500.framing import READ, REPLY_WANTED, Header, UsbMessage
from drivers.dlp4500.layout import Command, RawBytes, RegisterLayout, Values
from fpplab.core.errors import DeviceError, DeviceTimeoutError, DisconnectedError, ProtocolError, SettingError
from fpplab.core.logs import log_traffic

VENDOR, PRODUCT = 0x0451, 0x6401  # USB identity of the DLPC350
INTERFACE = 0  # the HID interface that takes commands, where the device has several (TI's client)
REPLY_TIMEOUT_S = 2.0  # longest wait in s for a reply, as in TI's client
MAX_STALE_REPORTS = 64
"""Unexpected reports that are discarded before the exchange is given up (chosen: 4 KiB)."""


class HidDevice(Protocol):
    """An open HID device, as hidapi's `hid.device`; an emulator implements the same methods."""

    def write(self, buff: bytes) -> int:
        """Send a report number, which is 0, and 64 bytes; return how many were written, or -1."""

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        """Receive a report without its number, empty after the time-out; 0 waits without a limit."""

    def close(self) -> None:
        """Close the device."""


class HidModule(Protocol):
    """The functions of hidapi's module `hid` that the driver uses."""

    def enumerate(self, vendor_id: int, product_id: int) -> list[dict[str, Any]]:
        """List interfaces, with the keys `path`, `serial_number` and `interface_number`."""

    def device(self) -> Any:
        """Create a `HidDevice` that is not open yet, with the additional method `open_path`."""


def load_hidapi(name: str) -> HidModule:
    try:
        import hid
    except ImportError as error:
        raise DeviceError(
            name, "open", f"hidapi does not load ({error})", "install the package libusb-1.0-0"
        ) from error
    module: HidModule = hid
    return module


def command_interfaces(hid: HidModule) -> list[dict[str, Any]]:
    """List the interface of each connected board that takes commands."""
    # macOS numbers none: of two with one serial number the first path is taken (not tested on a board).
    boards: dict[str, dict[str, Any]] = {}
    for interface in sorted(hid.enumerate(VENDOR, PRODUCT), key=lambda listed: listed["path"]):
        if interface["interface_number"] == INTERFACE:
            boards[interface["path"]] = interface
        elif interface["interface_number"] == -1:
            boards.setdefault(interface["serial_number"] or "", interface)
    return list(boards.values())


def connect(hid: HidModule, name: str, serial: str | None) -> tuple[HidDevice, str]:
    interfaces = [
        (d["path"], d["serial_number"] or "")
        for d in command_interfaces(hid)
        if serial in (None, d["serial_number"])
    ]
    if not interfaces:
        with_serial = f" with serial number {serial}" if serial is not None else ""
        raise DisconnectedError(
            name, "open", f"no LightCrafter 4500{with_serial} is connected", "check its power and USB cable"
        )
    if len(interfaces) > 1:
        raise DeviceError(
            name,
            "open",
            f"{len(interfaces)} LightCrafters 4500 are connected",
            f"name one of {sorted(number for _, number in interfaces)} as 'serial' in the rig file",
        )
    wire = hid.device()
    try:
        wire.open_path(interfaces[0][0])
    except OSError as error:
        raise DeviceError(
            name, "open", f"the USB device cannot be opened ({error})", "close other programs that use it"
        ) from error
    return wire, interfaces[0][1]


class Link:
    """Exchange of requests and replies with the controller."""

    def __init__(
        self,
        wire: HidDevice,
        clock: Clock,
        name: str,
        checks_echo: bool = True,
        timeout_s: float = REPLY_TIMEOUT_S,
    ) -> None:
        self._wire, self._clock, self.name = wire, clock, name
        self._checks_echo, self._timeout_s = checks_echo, timeout_s
        self.requests = 0

    def close(self) -> None:
        self._wire.close()

    def write(self, command: Command, **values: int) -> None:
        """Write a command whose data are bit fields."""
        self._write(command, self._packed(command, command.written, values))

    def write_bytes(self, command: Command, data: bytes) -> None:
        """Write a command whose data are plain bytes; raises the same errors as `write`."""
        assert isinstance(command.written, RawBytes)
        try:
            command.written.check(data)
        except ValueError as error:
            raise SettingError(self.name, command.name, str(error)) from error
        self._write(command, data)

    def read(self, command: Command) -> Values:
        """Read a command whose reply consists of bit fields; raises the same errors as `write`."""
        data = self._query(command, {})
        try:
            assert isinstance(command.returned, RegisterLayout)
            return command.returned.unpack(data)
        except ValueError as error:
            raise self._protocol_error(command.name, str(error)) from error

    def read_bytes(self, command: Command, **selector: int) -> bytes:
        """Read a command whose reply is plain bytes; raises the same errors as `read`."""
        data = self._query(command, selector)
        try:
            assert isinstance(command.returned, RawBytes)
            command.returned.check(data)
        except ValueError as error:
            raise self._protocol_error(command.name, str(error)) from error
        return data

    def drain(self) -> None:
        """Discard all reports that wait to be read, or raise `ProtocolError` if they do not end."""
        for _ in range(MAX_STALE_REPORTS):
            if not self._report("drain", 1):
                return
        raise self._protocol_error("drain", "unexpected reports keep arriving")

    def _write(self, command: Command, data: bytes) -> None:
        self._exchange(command, data, REPLY_WANTED if command.acknowledged else 0)

    def _query(self, command: Command, selector: Values) -> bytes:
        data = self._packed(command, command.selector, selector)
        reply = self._exchange(command, data, READ | REPLY_WANTED)
        assert reply is not None
        if not reply.payload:
            raise self._protocol_error(command.name, "an empty reply")
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
        # TI's client numbers reads 0 and matches nothing: after one late reply each of its reads returns the
        # data of the command before.
        sequence = self.requests % 256
        self.requests += 1
        for report in framing.make_request(command.number, data, sequence, flags).reports():
            self._send(command.name, report)
        if not flags & REPLY_WANTED:
            return None
        reply = self._reply(command.name, flags, sequence)
        if reply.failed:
            raise ProtocolError(
                self.name, command.name, "the projector refused the command", "see 'fpplab dlp4500 status'"
            )
        return reply

    def _send(self, operation: str, report: bytes) -> None:
        log_traffic(self.name, "to", report)
        try:
            sent = self._wire.write(b"\0" + report)
        except OSError as error:
            raise self._disconnected(operation) from error
        if sent < 0:
            raise self._disconnected(operation)

    def _reply(self, operation: str, flags: int, sequence: int) -> UsbMessage:
        deadline = self._clock.now() + self._timeout_s
        other: Header | None = None
        for _ in range(MAX_STALE_REPORTS):
            try:
                report = self._next_report(operation, deadline)
                head = framing.parse_header(report)
                message = self._complete_reply(operation, head, flags, report, deadline)
            except ValueError as error:
                raise self._protocol_error(operation, str(error)) from error
            except DeviceTimeoutError as error:
                if other is None:
                    raise
                raise self._unmatched(operation, other, flags, sequence) from error
            if self._answers(head, flags, sequence):
                return message
            other = head
        raise self._protocol_error(operation, "only replies to other requests arrived")

    def _unmatched(self, operation: str, other: Header, flags: int, sequence: int) -> ProtocolError:
        """Describe replies that arrived but do not belong to the request."""
        return ProtocolError(
            self.name,
            operation,
            f"no reply to the request arrived, but one with the sequence number {other.sequence} and flags "
            f"{other.flags:#04x} instead of {sequence} and {flags:#04x}",
            "a board that does not return them needs 'checks_echo: false' in the rig file, or --no-echo",
        )

    def _answers(self, head: Header, flags: int, sequence: int) -> bool:
        if not self._checks_echo:
            return True
        return head.sequence == sequence and head.flags & ~framing.ERROR == flags

    def _complete_reply(
        self, operation: str, head: Header, flags: int, first: bytes, deadline: float
    ) -> UsbMessage:
        """Receive the rest of a reply; acknowledgements and refusals are always one report."""
        # Without echo the request alone says whether it is the reply to a read.
        reads = (head.flags if self._checks_echo else flags) & READ
        if not reads or head.flags & framing.ERROR:
            return UsbMessage(head.flags, head.sequence)
        rest = [
            self._next_report(operation, deadline) for _ in range(framing.continuation_reports(head.length))
        ]
        return framing.join_reports([first, *rest])

    def _next_report(self, operation: str, deadline: float) -> bytes:
        """Return the next report, or raise `DeviceTimeoutError` at the deadline."""
        remaining_ms = max(1, round(1e3 * (deadline - self._clock.now())))  # 0 would wait without a limit
        report = self._report(operation, remaining_ms)
        if not report:
            raise DeviceTimeoutError(
                self.name,
                operation,
                f"no complete reply within {self._timeout_s:g} s",
                "check the USB cable; switch the projector off and on",
            )
        return report

    def _report(self, operation: str, timeout_ms: int) -> bytes:
        try:
            report = bytes(self._wire.read(framing.REPORT_BYTES, timeout_ms))
        except OSError as error:
            raise self._disconnected(operation) from error
        if report:
            log_traffic(self.name, "from", report)
        return report

    def _disconnected(self, operation: str) -> DisconnectedError:
        return DisconnectedError(
            self.name,
            operation,
            "the USB device was unplugged or switched off",
            "check its power and cable, and open it again",
        )

    def _protocol_error(self, operation: str, reason: str) -> ProtocolError:
        return ProtocolError(self.name, operation, reason, "switch the projector off and on")
