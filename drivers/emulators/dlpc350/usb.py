"""The emulated controller behind an interface like that of hidapi, with faults of the USB connection."""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from enum import Enum, auto
from itertools import count
from typing import Any

from drivers.dlp4500.framing import REPORT_BYTES, UsbMessage, continuation_reports, join_reports, parse_header
from drivers.dlp4500.transport import INTERFACE, PRODUCT, VENDOR
from drivers.emulators.dlpc350.firmware import Dlpc350

LATE_S = 3.0  # delay in s of a reply with the fault `UsbFault.LATE`: longer than the driver waits for one


class UsbFault(Enum):
    """What happens to one request or to its reply."""

    DROP = auto()
    """Carried out, but the reply is lost."""
    LATE = auto()
    """Carried out, and the reply comes after `LATE_S`."""
    DUPLICATE = auto()
    """Carried out, and the reply comes twice."""
    NACK = auto()
    """Not carried out, and the reply has the error bit."""
    SHORT = auto()
    """Carried out, and the reports of the reply are truncated."""
    UNPLUG_BEFORE = auto()
    """Not carried out: the cable is unplugged before."""
    UNPLUG_AFTER = auto()
    """Carried out, and the cable is unplugged before the reply."""


class UnpluggedError(OSError):
    """Raised, as by hidapi, on reading from a device that was unplugged."""


class EmulatedHid:
    """Stands in for the module `hid`, with one projector plugged in."""

    def __init__(
        self, controller: Dlpc350, serial: str = "LCR3", faults: Mapping[int, UsbFault] | None = None
    ):
        self.controller, self.serial = controller, serial
        self.faults = dict(faults or {})
        self.requests = 0
        self.plugs = 1
        self._plugged_from_s: float | None = 0.0
        controller.on_restart = self.leave_bus

    @property
    def is_plugged(self) -> bool:
        return self._plugged_from_s is not None and self.controller.clock.now() >= self._plugged_from_s

    def unplug(self) -> None:
        """Unplug the USB cable; the projector itself goes on."""
        self._plugged_from_s = None
        self.plugs += 1

    def plug(self) -> None:
        self._plugged_from_s = self.controller.clock.now()

    def leave_bus(self, seconds: float) -> None:
        """Be absent from the bus for a while, as in a reset."""
        self.unplug()
        self._plugged_from_s = self.controller.clock.now() + seconds

    def enumerate(self, vendor_id: int = 0, product_id: int = 0) -> list[dict[str, Any]]:
        if not self.is_plugged or (vendor_id, product_id) != (VENDOR, PRODUCT):
            return []
        return [
            {
                "path": f"emulated:{number}".encode(),
                "interface_number": number,
                "serial_number": self.serial,
                "product_string": "DLPC350",
            }
            for number in (INTERFACE + 1, INTERFACE)
        ]

    def device(self) -> EmulatedDevice:
        return EmulatedDevice(self)


class EmulatedDevice:
    """Stands in for hidapi's `hid.device`: reports in, reports out."""

    def __init__(self, hid: EmulatedHid) -> None:
        self._hid, self._clock = hid, hid.controller.clock
        self._plug: int | None = None
        self._incoming: list[bytes] = []
        self._outgoing: list[tuple[float, int, bytes]] = []
        self._order = count()

    def open_path(self, path: bytes) -> None:
        if not self._hid.is_plugged or path != f"emulated:{INTERFACE}".encode():
            raise OSError("open failed")
        self._plug = self._hid.plugs

    def close(self) -> None:
        self._plug = None

    def write(self, buff: bytes) -> int:
        if not self._is_alive():
            return -1
        if len(buff) != REPORT_BYTES + 1 or buff[0]:
            return -1
        self._collect_report(bytes(buff[1:]))
        return len(buff)

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        if timeout_ms <= 0:
            raise ValueError("hidapi would wait without limit")
        if not self._is_alive():
            raise UnpluggedError("read error")
        now = self._clock.now()
        deadline = now + 1e-3 * timeout_ms
        due = self._outgoing[0][0] if self._outgoing else float("inf")
        if due > deadline:
            self._clock.sleep(deadline - now)
            return []
        if due > now:
            self._clock.sleep(due - now)
        return list(heapq.heappop(self._outgoing)[2][:max_length])

    def has_report(self) -> bool:
        """Return whether a report can be read without waiting."""
        return self._is_alive() and bool(self._outgoing) and self._outgoing[0][0] <= self._clock.now()

    def _is_alive(self) -> bool:
        return self._plug == self._hid.plugs and self._hid.is_plugged

    def _collect_report(self, report: bytes) -> None:
        """Collect reports until a message is complete."""
        self._incoming.append(report)
        try:
            length = parse_header(self._incoming[0]).length
        except ValueError:
            self._incoming = []  # longer than the buffer: it cannot be answered
            return
        if len(self._incoming) == 1 + continuation_reports(length):
            message, self._incoming = join_reports(self._incoming), []
            self._answer_message(message)

    def _answer_message(self, message: UsbMessage) -> None:
        hid, controller = self._hid, self._hid.controller
        fault = hid.faults.get(hid.requests)
        hid.requests += 1
        if fault is UsbFault.UNPLUG_BEFORE:
            hid.unplug()
            return
        reply = controller.nack(message) if fault is UsbFault.NACK else controller.answer(message)
        if fault is UsbFault.UNPLUG_AFTER:
            hid.unplug()
        elif reply is not None and fault is not UsbFault.DROP:
            self._send_reply(reply, fault)

    def _send_reply(self, reply: UsbMessage, fault: UsbFault | None) -> None:
        due = self._clock.now() + self._hid.controller.policy.turnaround_s
        due += LATE_S if fault is UsbFault.LATE else 0.0
        for report in reply.reports() * (2 if fault is UsbFault.DUPLICATE else 1):
            sent = report[: REPORT_BYTES // 2] if fault is UsbFault.SHORT else report
            heapq.heappush(self._outgoing, (due, next(self._order), sent))
